"""`drapemeter rank`: order a library of fabrics by drape."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from services import console
from services.cli.options import JSON
from simcore.errors import InputError

if TYPE_CHECKING:
    from metric.backends import Backend
    from metric.library import LibraryFabric
    from metric.search import RankedFabric, SearchResult
    from metric.simulate import SimulationPlan
    from simcore.parameters import FabricParameters


SHOWN = 6
"""Fabrics a row of the figure where ``--top`` does not say."""
MOST_SHOWN = 12
"""Fabrics a row at most: with more none can be made out."""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("rank")(rank)


def rank(
    reference: Path = typer.Argument(..., metavar="REFERENCE.json", help="The seven parameters of the reference."),
    library: Path = typer.Argument(..., metavar="LIBRARY.json", help="Fabrics with id and the seven parameters."),
    top: int = typer.Option(0, help="Only the nearest so many; 0 for all."),
    simulations: int = typer.Option(5, help="Simulations of each fabric in each scene."),
    backend: str = typer.Option("lpips", help="Image distance: lpips, depth, ssim, ...; an unknown name lists them."),
    resolution: float = typer.Option(0.01, help="Edge of a mesh cell [m]; must divide 0.5 m."),
    seed: int = typer.Option(0, help="Of the jitter: the same seed gives the same drapes."),
    workers: int = typer.Option(0, help="Worker processes; 0 for one a core."),
    cache: bool = typer.Option(True, help="Keep renders and sketches between runs (folder DRAPEMETER_CACHE)."),
    exact: bool | None = typer.Option(
        None, "--exact/--sketch", help="Full features, or sketches good to 1 %; by default full up to 20 fabrics."
    ),
    thumbnails: Path | None = typer.Option(None, help="Folder for a PNG of each ranked fabric in each scene."),
    figure: Path | None = typer.Option(
        None,
        help="PNG: drape ranking beside the ranking by parameters; of each as many as --top says "
        f"({SHOWN} if it is not given, {MOST_SHOWN} at most).",
    ),
    json_output: bool = JSON,
) -> None:
    """Order a library of fabrics by drape distance from a reference, the most alike first.

    LIBRARY is a JSON list of objects with id and the seven numbers, an object with such a list under "fabrics", or a
    CSV file with a header. The first query simulates; what it simulated is kept, and the next ones are quick.

    \b
    Example:
      drapemeter rank silk.json library.json --top 5 --figure search.png --json
    """
    from metric.library import load_library
    from services.cli.metric_options import check_resolution
    from services.cli.plates import note_raised_bias
    from simcore.parameters import FabricParameters

    fabric = FabricParameters.load(reference)
    entries = load_library(library)
    check_resolution(resolution)
    if top < 0:
        raise InputError(f"--top must not be negative, got {top}: give 0 for all", code="top_out_of_range")
    raised = note_raised_bias([(str(reference), fabric), *((entry.id, entry.parameters) for entry in entries)])
    from metric.backends import check_backend, get_backend
    from metric.simulate import SimulationPlan

    plan = SimulationPlan(simulations=simulations, resolution_m=resolution, seed=seed, workers=workers)
    check_backend(backend)
    _check_outputs(figure, thumbnails)
    metric = get_backend(backend)
    found = _search(fabric, entries, metric, plan, keep=cache, exact=exact)
    ranking = found.ranking[:top] if top else found.ranking
    for lost in found.failed:
        console.note(f"{lost.id} has no place: {lost.reason}")
    files = _write_thumbnails(ranking, thumbnails) if thumbnails is not None else {}
    if figure is not None:
        _write_figure(figure, fabric, entries, found, metric.name, columns=min(top or SHOWN, MOST_SHOWN))
    if json_output:
        rows = [_row(entry, files.get(entry.id)) for entry in ranking]
        settings = {"backend": metric.name, "unit": metric.unit, "simulations": simulations, "seed": seed}
        lost_or_raised = {"failed": found.failed, "raised_bias": raised}
        console.emit_json({"ranking": rows, **settings, "resolution": resolution, **lost_or_raised})
        return
    _print(ranking, metric.unit)


def _check_outputs(figure: Path | None, thumbnails: Path | None) -> None:
    """Refuse places that could not be written to later, and make the folders.

    Raises:
        InputError: one of them cannot be used.
    """
    from services.cli.outputs import check_figure, make_folder

    if figure is not None:
        check_figure(figure)
    if thumbnails is not None:
        make_folder(thumbnails, "name a folder that can be written to")


def _search(
    reference: FabricParameters,
    library: list[LibraryFabric],
    backend: Backend,
    plan: SimulationPlan,
    *,
    keep: bool,
    exact: bool | None,
) -> SearchResult:
    """Search under a progress bar, with the user's caches unless nothing is to be kept."""
    from metric.search import search_library
    from services.cli.caches import metric_caches

    kept = metric_caches(keep)
    with console.progress("simulating", 2 * plan.simulations * (1 + len(library))) as bar:
        return search_library(
            reference,
            library,
            backend,
            plan,
            renders=kept.renders,
            features=kept.features,
            descriptors=kept.descriptors,
            exact=exact,
            on_done=bar.advance,
        )


def _row(entry: RankedFabric, files: dict[str, str] | None) -> dict[str, Any]:
    row: dict[str, Any] = {"id": entry.id, "distance": entry.distance, "standard_error": entry.standard_error}
    return row if files is None else {**row, "thumbnails": files}


def _print(ranking: list[RankedFabric], unit: str) -> None:
    from services.cli.metric_options import unit_text

    for place, entry in enumerate(ranking, start=1):
        error = "" if entry.standard_error is None else f" ± {entry.standard_error:.4f}"
        console.say(f"{place:>4}  {entry.distance:.4f}{error}{unit_text(unit)}  {entry.id}")


def _write_thumbnails(ranking: list[RankedFabric], folder: Path) -> dict[str, dict[str, str]]:
    """One PNG a fabric and scene; id to scene to path."""
    from renderer.picture import write_png

    found: dict[str, dict[str, str]] = {}
    for place, entry in enumerate(ranking, start=1):
        found[entry.id] = {}
        for scene, picture in entry.pictures.items():
            path = folder / f"{place:03d}-{scene}.png"
            write_png(path, picture)
            found[entry.id][scene.value] = str(path)
    return found


def _write_figure(
    path: Path,
    reference: FabricParameters,
    library: list[LibraryFabric],
    found: SearchResult,
    name: str,
    *,
    columns: int,
) -> None:
    """The drape ranking beside the ranking of the same fabrics by their parameters, the nearest of each."""
    import numpy as np

    from metric.figures import search_figure
    from metric.parameter_distance import ParameterDistance

    ranking = found.ranking
    parameters = {entry.id: entry.parameters for entry in library}
    matrix = ParameterDistance.of_prior().matrix([reference, *(parameters[r.id] for r in ranking)])
    order = np.argsort(matrix[0, 1:], kind="stable")
    by_parameters = [(ranking[k].id, float(matrix[0, 1 + k]), ranking[k].pictures) for k in order]
    by_drape = [(r.id, r.distance, r.pictures) for r in ranking]
    rows = {f"drape ({name})": by_drape, "parameters (z-scores of logarithms)": by_parameters}
    search_figure(path, found.reference_pictures, rows, columns=columns)
