"""`drapemeter distance`: how alike two fabrics drape."""

from __future__ import annotations

from pathlib import Path

import typer

from services import console
from services.cli.options import JSON


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("distance")(distance)


def distance(
    a: Path = typer.Argument(..., metavar="A.json", help="The seven parameters of one fabric."),
    b: Path = typer.Argument(..., metavar="B.json", help="The seven parameters of the other."),
    simulations: int = typer.Option(5, help="Simulations of each fabric in each scene."),
    backend: str = typer.Option("lpips", help="Image distance: lpips, depth, ssim, ...; an unknown name lists them."),
    resolution: float = typer.Option(0.01, help="Edge of a mesh cell [m]; must divide 0.5 m."),
    seed: int = typer.Option(0, help="Of the jitter: the same seed gives the same drapes."),
    workers: int = typer.Option(0, help="Worker processes; 0 for one a core."),
    cache: bool = typer.Option(True, help="Keep renders and features between runs (folder DRAPEMETER_CACHE)."),
    json_output: bool = JSON,
) -> None:
    """Drape distance between two fabrics, as people see it.

    Simulates each fabric several times in both scenes, renders, and averages an image distance over all pairs of
    renders (LPIPS unless --backend says otherwise). A fabric's distance from itself is not zero: its repeats differ.

    \b
    Example:
      drapemeter distance denim.json silk.json --simulations 5 --json
      drapemeter distance denim.json silk.json --backend depth
    """
    from services.cli.caches import metric_caches
    from services.cli.metric_options import check_resolution, unit_text
    from services.cli.plates import note_raised_bias
    from simcore.parameters import FabricParameters

    fabric_a, fabric_b = FabricParameters.load(a), FabricParameters.load(b)
    check_resolution(resolution)
    raised = note_raised_bias([(str(a), fabric_a), (str(b), fabric_b)])
    from metric.backends import get_backend
    from metric.compare import compare_fabrics
    from metric.simulate import SimulationPlan

    plan = SimulationPlan(simulations=simulations, resolution_m=resolution, seed=seed, workers=workers)
    metric = get_backend(backend)
    kept = metric_caches(cache)
    with console.progress("simulating", 4 * simulations) as bar:
        found = compare_fabrics(
            fabric_a, fabric_b, metric, plan, renders=kept.renders, features=kept.features, on_done=bar.advance
        )
    result = found.result
    for retry in found.retries:
        which = f"{'AB'[retry.fabric]} ({(a, b)[retry.fabric]})"
        console.note(f"{which}: {retry.scene} {retry.repeat} was simulated again: {'; '.join(retry.reasons)}")
    if json_output:
        console.emit_json(
            {
                "distance": result.distance,
                "standard_error": result.standard_error,
                "scenes": result.scenes,
                "simulations": simulations,
                "backend": result.backend,
                "unit": result.unit,
                "scene_standard_errors": result.scene_errors,
                "resolution": resolution,
                "seed": seed,
                "raised_bias": raised,
                "retries": [{**vars(retry), "fabric": "AB"[retry.fabric]} for retry in found.retries],
            }
        )
        return
    error = "" if result.standard_error is None else f" ± {result.standard_error:.4f}"
    console.say(f"drape distance {result.distance:.4f}{error}{unit_text(result.unit)}  ({result.backend})")
    for scene, value in result.scenes.items():
        console.say(f"  {scene:<8} {value:.4f}")
