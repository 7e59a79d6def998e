"""`drapemeter study compare`: which image distance finds what is known beforehand."""

from __future__ import annotations

import json
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from services import console
from services.cli.options import JSON
from services.names import split_names
from services.plain_json import to_plain
from simcore.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from metric.backends import Backend
    from metric.comparison import BackendScore
    from metric.parameter_distance import ParameterDistance
    from metric.simulate import FabricRenders, SimulationPlan
    from simcore.parameters import FabricParameters

FEWEST_ORDERED = 3
"""Fabrics of a sweep without which none lies between others."""
EVERY = "lpips,ssim,ms-ssim,psnr,depth,silhouette,normals,trunk"


def compare(
    backends: str = typer.Option(EVERY, help="Image distances, separated by commas."),
    fabrics: int = typer.Option(30, min=3, max=500, help="Fabrics drawn from the prior."),
    steps: int = typer.Option(6, min=3, max=50, help="Fabrics a sweep."),
    simulations: int = typer.Option(5, help="Simulations of each fabric in each scene."),
    resolution: float = typer.Option(0.01, help="Edge of a mesh cell [m]; must divide 0.5 m."),
    seed: int = typer.Option(0, min=0, help="Of fabrics, drapes and choices of repeats."),
    workers: int = typer.Option(0, help="Worker processes; 0 for one a core."),
    model: Path | None = typer.Option(None, help="Estimator whose features `trunk` takes; default: the shipped one."),
    out: Path | None = typer.Option(None, help="Folder for comparison.json and shares.png."),
    json_output: bool = JSON,
) -> None:
    """Rank image distances on orderings that are known: repeats of one fabric closer than any other fabric, and sweeps
    of bending, stretch and density monotone; both for every number of simulations up to the one given.

    \b
    Example:
      drapemeter study compare --fabrics 30 --simulations 5 --out comparison/
    """
    from metric.orderings import default_sweeps
    from metric.simulate import SimulationPlan
    from services.cli.metric_options import check_resolution
    from services.cli.outputs import check_folder, make_folder
    from simcore.prior import FabricPrior

    check_resolution(resolution)
    plan = SimulationPlan(simulations=simulations, resolution_m=resolution, seed=seed, workers=workers)
    if simulations < 2:
        raise InputError("the comparison needs at least 2 simulations of each fabric", code="simulations_out_of_range")
    chosen = [_backend(name, model) for name in split_names(backends)]
    if not chosen:
        raise InputError("--backends names none: give at least one image distance", code="backends_missing")
    if out is not None:
        check_folder(out, "name a folder that can be written to")
    sweeps = {sweep.name: sweep.fabrics for sweep in default_sweeps(steps)}
    drawn = FabricPrior.default().sample(range(fabrics), seed)
    simulated = _simulate([*drawn, *chain.from_iterable(sweeps.values())], plan)
    names = [
        *(f"fabric {k}" for k in range(fabrics)),
        *(f"sweep {name}, step {k + 1}" for name, own in sweeps.items() for k in range(len(own))),
    ]
    left_out = [{"fabric": name, "reason": s.failure} for name, s in zip(names, simulated, strict=True) if s.failure]
    for lost in left_out:
        console.note(f"{lost['fabric']} is left out: {lost['reason']}")
    rest = iter(simulated[fabrics:])
    swept = {name: [f for f in islice(rest, len(own)) if not f.failure] for name, own in sweeps.items()}
    for name in [name for name, own in swept.items() if len(own) < FEWEST_ORDERED]:
        console.note(f"sweep {name} is left out: {len(swept.pop(name))} of its fabrics came to rest, too few")
    scores = _scores(chosen, [f for f in simulated[:fabrics] if not f.failure], swept, seed)
    document = {
        "fabrics": fabrics,
        "simulations": simulations,
        "resolution": resolution,
        "seed": seed,
        "simulated_again": sum(len(s.retries) for s in simulated),
        "left_out": left_out,
        "scores": [_row(score) for score in scores],
        "parameters": _parameter_rows(drawn, sweeps),
    }
    if out is not None:
        make_folder(out, "name a folder that can be written to")
        _write(out, document, scores)
    if json_output:
        console.emit_json(document)
    else:
        _print(document)


def _simulate(fabrics: Sequence[FabricParameters], plan: SimulationPlan) -> list[FabricRenders]:
    """Every fabric in turn; one that does not come to rest stays in its place, with the reason."""
    from metric.simulate import simulate_fabrics
    from services.cli.caches import metric_caches

    renders = metric_caches().renders
    with console.progress("simulating", 2 * plan.simulations * len(fabrics)) as bar:
        return simulate_fabrics(fabrics, plan, cache=renders, keep_failures=True, on_done=bar.advance)


def _backend(name: str, model: Path | None) -> Backend:
    """An image distance by name; the estimator's own features are one more."""
    if name == "trunk":
        from services.trunk_features import trunk_distance

        return trunk_distance(model)
    from metric.backends import get_backend

    return get_backend(name)


def _scores(
    backends: Sequence[Backend], fabrics: Sequence[FabricRenders], sweeps: dict[str, list[FabricRenders]], seed: int
) -> list[BackendScore]:
    from metric.comparison import score_backend

    found = []
    count = 2 * (len(fabrics) + sum(len(s) for s in sweeps.values()))
    with console.progress("comparing", count * len(backends)) as bar:
        for backend in backends:
            bar.update(description=backend.name)
            sets = {name: [f.scenes for f in renders] for name, renders in sweeps.items()}
            scenes = [f.scenes for f in fabrics]
            found.append(score_backend(backend, scenes, sets, seed=seed, on_done=bar.advance))
    return sorted(found, key=lambda s: -s.self_nearest - sum(s.monotone.values()) / max(1, len(s.monotone)))


def _row(score: BackendScore) -> dict[str, Any]:
    return {name: value for name, value in vars(score).items() if name != "matrix"}


def _parameter_rows(
    drawn: Sequence[FabricParameters], sweeps: dict[str, tuple[FabricParameters, ...]]
) -> dict[str, Any]:
    """The parameter distance on the sweeps; it has no repeats, so d(a, a) = 0 says nothing."""
    from metric.orderings import monotone_share
    from metric.parameter_distance import ParameterDistance

    distances: dict[str, ParameterDistance] = {
        "z-score of logarithms": ParameterDistance.of_population(drawn),
        "z-score": ParameterDistance.of_population(drawn, logarithmic=False),
    }
    return {
        name: {sweep: monotone_share(d.matrix(fabrics)) for sweep, fabrics in sweeps.items()}
        for name, d in distances.items()
    }


def _write(out: Path, document: dict[str, Any], scores: Sequence[BackendScore]) -> None:
    from metric.figures import share_figure
    from renderer.atomic import write_atomically

    write_atomically(out / "comparison.json", json.dumps(to_plain(document), indent=1).encode())
    share_figure(out / "shares.png", {score.name: score.by_simulations for score in scores})


def _print(document: dict[str, Any]) -> None:
    scores = document["scores"]
    sweeps = list(scores[0]["monotone"])
    console.say(f"{'':<14} d(a,a)<d(a,b)  " + "  ".join(f"{name:>8}" for name in sweeps) + "   ms a render")
    for row in scores:
        monotone = "  ".join(f"{100 * row['monotone'][name]:>7.1f}%" for name in sweeps)
        milliseconds = 1e3 * row["seconds"] / row["renders"]
        console.say(f"{row['name']:<14} {100 * row['self_nearest']:>12.1f}%  {monotone}   {milliseconds:>11.1f}")
