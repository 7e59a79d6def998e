"""`drapemeter simulate`: one fabric, one scene, one drape."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from services.cli import console
from simcore.errors import InputError

if TYPE_CHECKING:
    from diagnosis.scene import SimulationScene
    from simcore.drape import Drape

CODE_NOT_STILL = "drape_not_still"
RESULT_NAMES = ("status", "residual", "energy", "stable", "iterations", "seconds", "reason")


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("simulate")(simulate)


def simulate(
    scene: str = typer.Option(..., "--scene", help="hanging or stretch."),
    parameters: Path = typer.Option(..., "--parameters", help="JSON file with the seven fabric parameters, SI."),
    out: Path = typer.Option(..., "--out", help="The drape: PLY, float64, metres, panel frame."),
    resolution: float = typer.Option(0.005, "--resolution", help="Edge of a mesh cell [m]; must divide 0.5 m."),
    seed: int = typer.Option(0, "--seed", help="Of the jitter: the same seed gives the same bits."),
    effect: list[str] = typer.Option([], "--effect", help="NAME=MAGNITUDE, an effect to switch on; may be repeated."),
    depth: Path | None = typer.Option(None, "--depth", help="Also a 16-bit depth PNG."),
    capture_set: Path | None = typer.Option(None, "--capture-set", help="Also add the picture to this capture set."),
    fabric: str | None = typer.Option(
        None, "--fabric", help="The fabric's id there; default: the parameters' file name."
    ),
    json_output: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    """Bring one fabric to rest in one scene; write the drape and, if asked, its depth picture.

    Exits 0 when the drape is still: at rest and certified. Otherwise it exits 1, the status and its reason say why
    (not_still, under_resolved), and the files hold the best that was reached; of a diverged one nothing is written,
    and a capture set takes still drapes only.

    The depth picture is 256 x 256 pixels, fx = fy = 320, cx = cy = 127.5, 0.1 mm a count, taken 0.9 m before the
    panel at the height of the sample's middle. A capture set records that camera, the nominal set-up and the
    fabric's parameters, not the effects.

    \b
    Example:
      drapemeter simulate --scene hanging --parameters p.json --resolution 0.01 --out drape.ply --depth d.png
      drapemeter simulate --scene hanging --parameters p.json --effect air_draft=0.3 --out a.ply --capture-set drafty
    """
    from services.cli.simulate_files import add_capture, check_outputs, take_picture, write_files
    from simcore.mesh import GridMesh
    from simcore.parameters import FabricParameters

    nominal, changed = build_scene(scene, effect, pictured=depth is not None or capture_set is not None)
    cloth = FabricParameters.load(parameters)
    mesh = GridMesh(resolution)
    check_outputs(out, depth)
    if seed < 0:
        raise InputError(f"seed {seed} is negative: give 0 or more", code="seed_negative")

    from simcore.drape import DrapeStatus
    from simcore.solver import Solver

    drape = Solver(mesh).solve(cloth, changed.setup, seed=seed, mechanics=changed.mechanics)
    if drape.status is not DrapeStatus.DIVERGED:
        picture = None if depth is None and capture_set is None else take_picture(drape, changed, seed)
        write_files(drape, out, picture, depth)
        if drape.ok and capture_set is not None and picture is not None:
            add_capture(capture_set, fabric or parameters.stem, cloth, nominal, picture)
    report(drape, out, json_output)
    if not drape.ok:
        console.error_line(f"the drape is {drape.status}: {drape.reason}", CODE_NOT_STILL)
        raise typer.Exit(1)


def build_scene(name: str, effects: list[str], *, pictured: bool) -> tuple[SimulationScene, SimulationScene]:
    """The nominal scene, and the same with the effects on.

    Raises:
        InputError: unknown scene or effect, an effect given twice, or one that only a picture could show.
    """
    from diagnosis.effect import Stage
    from diagnosis.effects import parse_effect
    from diagnosis.scene import SimulationScene
    from simcore.scenes import Scene, Setup

    nominal = SimulationScene(Setup.nominal(Scene.parse(name)))
    changed = nominal
    seen: set[str] = set()
    for text in effects:
        effect, size = parse_effect(text)
        if effect.name in seen:
            raise InputError(f"effect {effect.name} is given twice: give it once", code="effect_twice")
        if effect.stage in (Stage.CAMERA, Stage.SENSOR) and not pictured:
            raise InputError(
                f"effect {effect.name} changes the picture alone: ask for one with --depth", code="effect_needs_picture"
            )
        seen.add(effect.name)
        changed = effect.apply(changed, size)
    return nominal, changed


def report(drape: Drape, out: Path, json_output: bool) -> None:
    """Print how it went."""
    if json_output:
        console.emit_json({name: getattr(drape, name) for name in RESULT_NAMES})
        return
    console.say(
        f"{drape.status}: residual {drape.residual:.1e} vertex weights, energy {drape.energy:.6g} J, "
        f"{drape.iterations} iterations, {drape.seconds:.2f} s -> {out}"
    )
