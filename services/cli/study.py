"""`drapemeter study`: the human study of drape similarity, and the comparison of image distances."""

from __future__ import annotations

import csv
import io
import json
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from services import console
from services.cli.options import JSON, SEED_FIXED, SEED_UNUSED
from services.cli.study_analyse import analyse
from services.cli.study_compare import compare
from services.cli.study_options import DATABASE, STUDY, open_database, open_study
from services.plain_json import to_plain
from simcore.errors import InputError

if TYPE_CHECKING:
    from services.web.study_create import StudyEntry

HELP = """Prepare, run and analyse a human study of drape similarity; compare image distances.

Participants see a reference fabric and two others and choose the one that drapes more like it.

\b
Example:
  drapemeter study make library.json --name pilot
  drapemeter study serve study_1f2e --port 8010
  drapemeter study analyse study_1f2e --out analysis/
  drapemeter study compare --fabrics 30 --out comparison/
"""


def register(app: typer.Typer) -> None:
    """Add the command group."""
    group = typer.Typer(help=HELP, rich_markup_mode=None)
    group.command("make")(make)
    group.command("list")(list_)
    group.command("serve")(serve)
    group.command("simulate")(simulate)
    group.command("analyse")(analyse)
    group.command("export")(export)
    group.command("compare")(compare)
    app.add_typer(group, name="study")


def make(
    library: Path | None = typer.Argument(None, metavar="LIBRARY.json", help="Fabrics with id and seven parameters."),
    name: str = typer.Option("Which drapes more alike?", help="Title that participants see."),
    photographs: Path | None = typer.Option(None, help="Show photographs: a folder with a subfolder for each fabric."),
    triplets: int = typer.Option(20, help="Questions a participant; each fabric is reference at least twice."),
    shared: int = typer.Option(5, help="Of these, questions put to everybody, to measure agreement."),
    simulations: int = typer.Option(3, help="Renders of each fabric in each scene; a question shows one at random."),
    resolution: float = typer.Option(0.01, help="Edge of a mesh cell [m]; must divide 0.5 m."),
    seed: int = typer.Option(0, help="Of the drapes and the questions."),
    workers: int = typer.Option(0, help="Worker processes; 0 for one a core."),
    database: str | None = DATABASE,
    json_output: bool = JSON,
) -> None:
    """Put a study into the database: renders of a library's fabrics, or photographs.

    With both LIBRARY and --photographs the photographs are shown and the library gives the parameters by name, so that
    metrics can be compared with the answers.

    \b
    Example:
      drapemeter study make library.json --name pilot --triplets 20
      drapemeter study make --photographs photos/ library.json
    """
    from services.cli.metric_options import check_resolution
    from services.web.study_create import create_study

    check_resolution(resolution)
    if not 0 <= seed < 2**31:
        raise InputError(f"the seed must be from 0 to 2147483647, got {seed}", code="seed_out_of_range")
    if not 0 <= shared <= triplets:
        raise InputError(f"--shared must be from 0 to --triplets, {triplets}; got {shared}", code="triplets_shared")
    entries_of = _shown(
        name,
        library,
        photographs,
        triplets,
        simulations=simulations,
        resolution=resolution,
        seed=seed,
        workers=workers,
    )
    with open_database(database) as opened:  # it makes a file: what is asked for is known to be possible by now
        entries = entries_of()
        store = create_study(opened, name, entries, triplets=triplets, shared=shared, seed=seed)
    if json_output:
        console.emit_json({"study": store.study.id, "fabrics": len(entries), "triplets": triplets, "shared": shared})
    else:
        console.say(f"{store.study.id}  {len(entries)} fabrics")
        console.say(f"run: drapemeter study serve {store.study.id}")


def list_(database: str | None = DATABASE, seed: int = SEED_UNUSED, json_output: bool = JSON) -> None:
    """List the studies of a database.

    \b
    Example:
      drapemeter study list
    """
    from services.web.study_create import list_studies

    with open_database(database, make=False) as opened:
        studies = list_studies(opened)
    if json_output:
        console.emit_json({"studies": studies})
        return
    for s in studies:
        simulated = f", {s['simulated_observers']} simulated" if s["simulated_observers"] else ""
        console.say(
            f"{s['id']}  {s['name']}: {s['fabrics']} fabrics, {s['participants']} participants of {s['begun']} who "
            f"began{simulated}, {s['answers']} answers"
        )


def serve(
    study: str = STUDY,
    host: str = typer.Option("127.0.0.1", help="Address to listen at; 0.0.0.0 lets others take part."),
    port: int = typer.Option(8010, min=0, max=65535, help="Port; 0 for any free one."),
    database: str | None = DATABASE,
    seed: int = SEED_FIXED,
    json_output: bool = typer.Option(False, "--json", help="One JSON document: where it is served, once it is."),
) -> None:
    """Serve the study's web page. Participants can close it and resume at the same address.

    \b
    Example:
      drapemeter study serve study_1f2e --host 0.0.0.0 --port 8010
    """
    import uvicorn

    from services.api.server import open_listener, url_of
    from services.web.study_app import create_study_app

    with open_study(database, study) as store, open_listener(host, port) as listener:
        server = uvicorn.Server(uvicorn.Config(create_study_app(store), log_level="warning"))
        if json_output:
            console.emit_json({"study": study, "url": f"{url_of(listener)}/"})
        console.note(f"{store.study.name}: {url_of(listener)}/  (Ctrl-C ends)")
        if listener.getsockname()[0] in {"0.0.0.0", "::"}:
            console.note(
                f"others reach it at http://{socket.gethostname()}:{listener.getsockname()[1]}/, or this "
                "machine's address in their network"
            )
        with suppress(KeyboardInterrupt):
            server.run(sockets=[listener])


def simulate(
    study: str = STUDY,
    observers: int = typer.Option(20, min=1, max=1000, help="Simulated observers."),
    noise: float = typer.Option(0.3, min=0.0, help="Of log distances as they see them; a large one is a coin."),
    seed: int = typer.Option(0, min=0, help="Of their choices; the plane is the study's."),
    database: str | None = DATABASE,
    json_output: bool = JSON,
) -> None:
    """Let simulated observers answer, to check the pipeline. They are labelled and never counted as people.

    They judge by distances in a random plane, not by the pictures; `analyse --simulated` must find that plane again.
    Those of another call judge by the same plane.

    \b
    Example:
      drapemeter study simulate study_1f2e --observers 20
    """
    import numpy as np

    from metric.observers import observer_stream, simulate_answers
    from metric.triplets import Triplet

    with open_study(database, study) as store:
        points = np.random.default_rng((store.study.seed, 2)).normal(0, 1, (len(store.fabrics), 2))
        distances = np.linalg.norm(points[:, None] - points[None, :], axis=2)
        for _ in range(observers):
            participant = store.add_participant(simulated=True)
            questions = [Triplet(*row[:3]) for row in participant.questions]
            rng = observer_stream(seed, participant.place)
            for position, chosen in enumerate(simulate_answers(questions, distances, rng, noise=noise)):
                store.answer(participant, position, chosen, 0)
    if json_output:
        console.emit_json({"study": study, "simulated_observers": observers, "points": points})
    else:
        console.say(f"{observers} simulated observers answered {study}")


def export(
    study: str = STUDY,
    out: Path = typer.Option(..., help="File to write: .csv or .json."),
    database: str | None = DATABASE,
    seed: int = SEED_UNUSED,
    json_output: bool = JSON,
) -> None:
    """Write every raw answer: who, which question, what was shown, what was chosen, how long it took.

    \b
    Example:
      drapemeter study export study_1f2e --out answers.csv
    """
    from services.web.study_store import ExportedAnswer

    if out.suffix not in {".csv", ".json"}:
        raise InputError(f"{out}: give a file that ends in .csv or .json", code="export_form")
    from renderer.atomic import write_atomically
    from services.cli.outputs import check_file, make_folder

    check_file(out)
    with open_study(database, study) as store:
        rows: list[dict[str, Any]] = [
            {**to_plain({**vars(row), "answered_at": row.answered_at.isoformat()})} for row in store.export()
        ]
    make_folder(out.absolute().parent, "name a place that can be written to")
    stream = io.StringIO(newline="")
    if out.suffix == ".json":
        json.dump(rows, stream, ensure_ascii=False, indent=1)
    else:
        writer = csv.DictWriter(stream, [f.name for f in fields(ExportedAnswer)])
        writer.writeheader()
        writer.writerows(rows)
    write_atomically(out, stream.getvalue().encode())
    if json_output:
        console.emit_json({"study": study, "answers": len(rows), "out": out})
    else:
        console.say(f"{len(rows)} answers in {out}")


def _shown(
    name: str, library: Path | None, photographs: Path | None, triplets: int, **plan: Any
) -> Callable[[], list[StudyEntry]]:
    """What makes the pictures of each fabric; names, whether so many can be asked about and the caches are checked at
    once."""
    from metric.library import load_library
    from metric.triplets import check_plan
    from services.web.study_create import check_names
    from services.web.study_pictures import entries_from_library, entries_from_photographs

    known = load_library(library) if library is not None else []
    check_names(name, [fabric.id for fabric in known])
    if photographs is not None:
        entries = entries_from_photographs(photographs, known)
        check_names(name, [entry.name for entry in entries])
        check_plan(len(entries), triplets)
        without = {fabric.id for fabric in known}.difference(entry.name for entry in entries)
        if without:
            console.note(f"no photographs of {', '.join(sorted(without))}: the study is without them")
        return lambda: entries
    if not known:
        raise InputError("give LIBRARY.json, --photographs, or both", code="study_empty")
    check_plan(len(known), triplets)
    from metric.simulate import SimulationPlan
    from services.cli.caches import metric_caches
    from services.cli.plates import note_raised_bias

    settings = SimulationPlan(
        simulations=plan["simulations"], resolution_m=plan["resolution"], seed=plan["seed"], workers=plan["workers"]
    )
    renders = metric_caches().renders
    note_raised_bias((fabric.id, fabric.parameters) for fabric in known)

    def rendered() -> list[StudyEntry]:
        with console.progress("simulating", 2 * settings.simulations * len(known)) as bar:
            return entries_from_library(known, settings, renders=renders, on_done=bar.advance)

    return rendered
