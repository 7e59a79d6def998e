"""`drapemeter rank`: order a library of fabrics by drape."""

from __future__ import annotations

from pathlib import Path

import typer

from services.cli import console

HELP = """Order a library of fabrics by drape distance from a reference, the most alike first.

LIBRARY is a JSON list of objects with id and the seven numbers, an object with such a list under "fabrics", or a
CSV file with a header. Renders are kept between runs: the first query simulates, the next ones do not.

\b
Example:
  drapemeter rank silk.json library.json --top 5 --json
"""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("rank", help=HELP)(rank)


def rank(
    reference: Path = typer.Argument(..., metavar="REFERENCE.json", help="The seven parameters of the reference."),
    library: Path = typer.Argument(..., metavar="LIBRARY.json", help="Fabrics with id and the seven parameters."),
    top: int = typer.Option(0, help="Only the nearest so many; 0 for all."),
    simulations: int = typer.Option(5, help="Simulations of each fabric in each scene."),
    backend: str = typer.Option("lpips", help="Image distance; lpips (SqueezeNet), depth and others."),
    resolution: float = typer.Option(0.01, help="Edge of a mesh cell [m]."),
    seed: int = typer.Option(0, help="Seed of the initial forces."),
    workers: int = typer.Option(0, help="Worker processes; 0 for one a core."),
    cache: bool = typer.Option(True, help="Keep renders and features between runs (folder DRAPEMETER_CACHE)."),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    from metric.library import load_library
    from services.cli.metric_options import caches, check_resolution, unit_text
    from simcore.errors import InputError
    from simcore.parameters import FabricParameters

    fabric = FabricParameters.load(reference)
    entries = load_library(library)
    check_resolution(resolution)
    if top < 0:
        raise InputError(f"--top must not be negative, got {top}", code="top_out_of_range")
    from metric.backends import get_backend
    from metric.search import rank_library
    from metric.simulate import SimulationPlan

    plan = SimulationPlan(simulations=simulations, resolution_m=resolution, seed=seed, workers=workers)
    metric = get_backend(backend)
    renders, features = caches(cache)
    with console.progress("simulating", 2 * simulations * (1 + len(entries))) as bar:
        ranking = rank_library(fabric, entries, metric, plan, renders=renders, features=features, on_done=bar.advance)
    ranking = ranking[:top] if top else ranking
    if as_json:
        console.emit_json({"ranking": ranking, "backend": metric.name, "unit": metric.unit, "simulations": simulations})
        return
    for place, entry in enumerate(ranking, start=1):
        error = "" if entry.standard_error is None else f" ± {entry.standard_error:.4f}"
        console.say(f"{place:>4}  {entry.distance:.4f}{error}{unit_text(metric.unit)}  {entry.id}")
