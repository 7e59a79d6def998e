"""`drapemeter study analyse`: what the answers of a human study say."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from services import console
from services.cli.options import JSON
from services.cli.study_options import DATABASE, STUDY, open_study
from services.names import split_names
from services.plain_json import to_plain
from simcore.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from metric.render_cache import RenderCache
    from metric.simulate import FabricRenders, SimulationPlan
    from metric.triplets import Answer
    from services.web.study_store import StudyStore
    from simcore.parameters import FabricParameters

EMBEDDED = 2
"""Dimensions of the embedding: of n fabrics it takes about so many times n log2 n answers (Jamieson and Nowak 2011)."""
FEWEST_RANKED = 3
"""Fabrics without which no ranking of others correlates with another."""


@dataclass(frozen=True)
class LeftOut:
    """A fabric that could not be simulated, on which no metric is compared with people."""

    fabric: str
    reason: str


@dataclass(frozen=True)
class Compared:
    """Fabrics as metrics see them.

    Attributes:
        matrices: distances by metric, [n, n]; every one has NaN in the row and the column of a fabric that could not be
            simulated, so that all are compared with people on the same fabrics.
        left_out: those fabrics.
        backends: by each name that was asked for, what it stands for.
        raised_bias: by fabric, that it was simulated with a larger ``bending_bias`` than it has.
    """

    matrices: dict[str, NDArray[np.float64]]
    left_out: list[LeftOut] = field(default_factory=list)
    backends: dict[str, str] = field(default_factory=dict)
    raised_bias: dict[str, str] = field(default_factory=dict)


def analyse(
    study: str = STUDY,
    backends: str = typer.Option("lpips", help="Image distances to compare with people, separated by commas."),
    simulated: bool = typer.Option(False, "--simulated", help="Analyse the simulated observers instead of people."),
    bootstrap: int = typer.Option(200, min=0, max=10_000, help="Resamples of participants for intervals; 0 for none."),
    simulations: int = typer.Option(5, help="Simulations of each fabric in each scene, for the image distances."),
    resolution: float = typer.Option(0.01, help="Edge of a mesh cell [m]; must divide 0.5 m."),
    seed: int = typer.Option(0, min=0, help="Of drapes, starts and resamples."),
    workers: int = typer.Option(0, help="Worker processes; 0 for one a core."),
    library: Path | None = typer.Option(
        None, help="Parameters to compare with people, CSV or JSON, by the fabrics' names; default: the study's own."
    ),
    out: Path | None = typer.Option(None, help="Folder for embedding.png and analysis.json."),
    database: str | None = DATABASE,
    json_output: bool = JSON,
) -> None:
    """Agreement between participants, the tSTE embedding of their answers, and how each metric's rankings correlate.

    Where a fabric has no known parameters, the embedding and the agreement are given alone. One that cannot be
    simulated is named, and metrics are compared over the others. `--backends ''` gives the distances of parameters
    alone. Estimated parameters, or such as were measured since, are compared with `--library`.

    \b
    Example:
      drapemeter study analyse study_1f2e --backends lpips,depth --out analysis/
      drapemeter study analyse study_1f2e --library estimated.json --out estimated/
    """
    from metric.library import load_library
    from metric.simulate import SimulationPlan
    from services.cli.metric_options import check_resolution
    from services.cli.outputs import check_folder

    given = {} if library is None else {fabric.id: fabric.parameters for fabric in load_library(library)}
    check_resolution(resolution)
    plan = SimulationPlan(simulations=simulations, resolution_m=resolution, seed=seed, workers=workers)
    if out is not None:
        check_folder(out, "name a folder that can be written to")
    with open_study(database, study) as store:
        answers = store.answers(simulated=simulated)
        if not answers:
            who = "simulated observers" if simulated else "people"
            raise InputError(f"study {study} has no answers of {who} yet", code="answers_missing")
        said = _evaluate(store, answers, split_names(backends), plan, bootstrap, given)
        document = {
            "study": study,
            "observers": "simulated" if simulated else "people",
            "settings": {
                "seed": seed,
                "bootstrap": bootstrap,
                "simulations": simulations,
                "resolution": resolution,
                "library": None if library is None else str(library),
            },
            **said,
        }
        _note_few(store, answers)
        if out is not None:
            _write(out, store, document, simulated)
    if json_output:
        console.emit_json(document)
    else:
        _print(document)


def _evaluate(
    store: StudyStore,
    answers: Sequence[Answer],
    backends: Sequence[str],
    plan: SimulationPlan,
    bootstrap: int,
    given: Mapping[str, FabricParameters],
) -> dict[str, Any]:
    """What the answers say, for the document; ``given``: parameters to compare, by name, in place of the study's."""
    from metric.agreement import agreement, metric_agreement
    from metric.tste import answer_array, embed

    count = len(store.fabrics)
    found = embed(answer_array(answers), count, seed=plan.seed)
    compared = _compare(store, backends, plan, given)
    matrices = compared.matrices
    scores = metric_agreement(matrices, answers, count, bootstrap=bootstrap, seed=plan.seed) if matrices else {}
    return {
        "participants": len({a.participant for a in answers}),
        "answers": len(answers),
        "agreement": agreement(answers),
        "embedding": {
            "fabrics": [f.name for f in store.fabrics],
            "points": found.points,
            "log_likelihood": found.log_likelihood,
        },
        "metrics": scores,
        "backends": compared.backends,
        "left_out": compared.left_out,
        "raised_bias": compared.raised_bias,
    }


def _compare(
    store: StudyStore, names: Sequence[str], plan: SimulationPlan, given: Mapping[str, FabricParameters]
) -> Compared:
    """Distances by every metric, none where parameters are unknown."""
    from metric.backends import check_backend, get_backend
    from metric.matrix import pair_tables
    from services.cli.caches import metric_caches
    from services.cli.plates import note_raised_bias
    from simcore.parameters import FabricParameters

    for name in names:
        check_backend(name)
    known = given or {f.name: FabricParameters.from_mapping(f.parameters) for f in store.fabrics if f.parameters}
    unknown = [fabric.name for fabric in store.fabrics if fabric.name not in known]
    if unknown:
        console.note(
            f"no metric is compared with people: parameters are unknown of {', '.join(unknown)}; --library gives them"
        )
        return Compared({})
    chosen = {name: get_backend(name) for name in names}
    fabrics = [known[fabric.name] for fabric in store.fabrics]
    found = _of_parameters(fabrics)
    if not chosen:
        return Compared(found)
    made = {name: backend.name for name, backend in chosen.items()}
    caches = metric_caches()
    raised = note_raised_bias((fabric.name, known[fabric.name]) for fabric in store.fabrics)
    simulated = _simulate(fabrics, plan, caches.renders)
    left_out = [
        LeftOut(fabric.name, s.failure) for fabric, s in zip(store.fabrics, simulated, strict=True) if s.failure
    ]
    for lost in left_out:
        console.note(f"no metric is compared with people on {lost.fabric}: {lost.reason}")
    kept = [k for k, s in enumerate(simulated) if not s.failure]
    if len(kept) < FEWEST_RANKED:
        console.note(
            f"no metric is compared with people: of {len(fabrics)} fabrics {len(kept)} could be simulated; try another "
            "--seed or a finer --resolution"
        )
        return Compared({}, left_out, made, raised)
    found = {name: _over(kept, matrix[kept][:, kept], len(fabrics)) for name, matrix in found.items()}
    for name, backend in chosen.items():
        tables = pair_tables([simulated[k].scenes for k in kept], backend, cache=caches.features)
        found[name] = _over(kept, tables.distances(), len(fabrics))
    return Compared(found, left_out, made, raised)


def _of_parameters(fabrics: Sequence[FabricParameters]) -> dict[str, NDArray[np.float64]]:
    """Distances of parameters, [n, n]: z-scores of logarithms against the prior, and, as in the paper, of values over
    the study's own fabrics, where these differ in every parameter."""
    from metric.parameter_distance import ParameterDistance

    found = {"parameters": ParameterDistance.of_prior().matrix(fabrics)}
    try:
        found["parameters_values"] = ParameterDistance.of_population(fabrics, logarithmic=False).matrix(fabrics)
    except InputError as error:
        console.note(f"parameters_values is not compared with people: {error}")
    return found


def _simulate(
    fabrics: Sequence[FabricParameters], plan: SimulationPlan, renders: RenderCache | None
) -> list[FabricRenders]:
    """Every fabric in turn; one that does not come to rest stays in its place, with the reason."""
    from metric.simulate import samples_apart, simulate_fabrics

    firsts = samples_apart(fabrics, plan)
    with console.progress("simulating", 2 * plan.simulations * len(fabrics)) as bar:
        return simulate_fabrics(
            fabrics, plan, first_repeats=firsts, cache=renders, keep_failures=True, on_done=bar.advance
        )


def _over(kept: Sequence[int], matrix: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Distances of the kept fabrics, [m, m], in their places among all, [n, n]; NaN elsewhere."""
    import numpy as np

    whole = np.full((count, count), np.nan)
    whole[np.ix_(kept, kept)] = matrix
    return whole


def _note_few(store: StudyStore, answers: Sequence[Answer]) -> None:
    """Say where the answers hardly place the fabrics."""
    named = {place for a in answers for place in (a.triplet.reference, a.triplet.left, a.triplet.right)}
    strange = [fabric.name for fabric in store.fabrics if fabric.place not in named]
    if strange:
        console.note(f"no answer names {', '.join(strange)}: they lie anywhere, and count in no correlation")
    count = len(store.fabrics)
    needed = math.ceil(EMBEDDED * count * math.log2(count))
    if len(answers) < needed:
        console.note(f"{len(answers)} answers place {count} fabrics poorly ({needed} are a beginning): ask more people")


def _write(out: Path, store: StudyStore, document: dict[str, Any], simulated: bool) -> None:
    from renderer.atomic import write_atomically
    from services.cli.outputs import make_folder

    make_folder(out, "name a folder that can be written to")
    _draw(out / "embedding.png", store, document["embedding"]["points"], simulated)
    write_atomically(out / "analysis.json", json.dumps(to_plain(document), indent=1).encode())


def _draw(path: Path, store: StudyStore, points: NDArray[np.float64], simulated: bool) -> None:
    import io

    import numpy as np
    from PIL import Image

    from metric.figures import embedding_figure

    shown = []
    for fabric in store.fabrics:
        first = store.picture(store.first_pictures(fabric.place)[0])
        with Image.open(io.BytesIO(first[1] if first is not None else b"")) as image:
            image.thumbnail((128, 128))
            shown.append(np.asarray(image.convert("L")))
    note = " (simulated observers)" if simulated else ""
    embedding_figure(path, points, [f.name for f in store.fabrics], shown, title=f"{store.study.name}{note}: tSTE")


def _print(document: dict[str, Any]) -> None:
    agreed = document["agreement"]
    share = "not measured" if agreed.share is None else f"{100 * agreed.share:.1f} % over {agreed.questions} questions"
    console.say(f"{document['participants']} {document['observers']}, {document['answers']} answers; agreement {share}")
    for name, score in document["metrics"].items():
        interval = "no interval" if score.interval_95 is None else "[{:.3f}, {:.3f}]".format(*score.interval_95)
        console.say(
            f"  {name:<17} Spearman {score.mean:.3f}  {interval}  "
            f"answers predicted {100 * score.answers_predicted:.1f} %"
        )
