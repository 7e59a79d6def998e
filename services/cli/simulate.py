"""`drapemeter simulate`: one fabric, one scene, one drape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from services import console
from services.cli.options import JSON
from simcore.errors import InputError

if TYPE_CHECKING:
    from diagnosis.effect import Effect
    from diagnosis.scene import SimulationScene
    from simcore.drape import Drape
    from simcore.parameters import FabricParameters

CODE_NOT_STILL = "drape_not_still"
EFFECT_SEED = "seed"
"""Component of an effect that is another one in every repeat."""
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
    pin_radius: float | None = typer.Option(
        None, "--pin-radius", help="What a magnet holds round its corner [m], 0 for a point; default: 0.01."
    ),
    depth: Path | None = typer.Option(None, "--depth", help="Also a 16-bit depth PNG."),
    time_limit: float | None = typer.Option(
        None, "--time-limit", min=0.0, help="CPU seconds after which the best so far is taken, not still."
    ),
    capture_set: Path | None = typer.Option(None, "--capture-set", help="Also add the picture to this capture set."),
    fabric: str | None = typer.Option(
        None, "--fabric", help="The fabric's id there; default: the parameters' file name."
    ),
    json_output: bool = JSON,
) -> None:
    """Bring one fabric to rest in one scene; write the drape and, if asked, its depth picture.

    Exits 0 when the drape is still: at rest and certified. Otherwise it exits 1, the status and its reason say why
    (not_still, under_resolved), and the files hold the best that was reached; of a diverged one nothing is written,
    and a capture set takes still drapes only.

    The depth picture is 256 x 256 pixels, fx = fy = 320, cx = cy = 127.5, 0.1 mm a count, taken 0.9 m before the
    panel at the height of the sample's middle. A capture set records that camera, the nominal set-up, the
    fabric's parameters and an ideal sensor, not the effects; one that says something else of the fabric or the sensor
    is refused. An effect that is another one in every repeat follows the seed unless given one (seed:NUMBER).

    \b
    Example:
      drapemeter simulate --scene hanging --parameters p.json --resolution 0.01 --out drape.ply --depth d.png
      drapemeter simulate --scene hanging --parameters p.json --effect air_draft=0.3 --out a.ply --capture-set drafty
    """
    from services.cli.plates import note_raised_bias
    from services.cli.simulate_files import CapturePlan, check_outputs, check_picture, files_written, take_picture
    from simcore.mesh import GridMesh
    from simcore.parameters import FabricParameters

    check_options(seed, fabric, capture_set)
    cloth = FabricParameters.load(parameters)
    pictured = depth is not None or capture_set is not None
    nominal, changed = build_scene(scene, effect, cloth, seed, pictured=pictured, pin_radius_m=pin_radius)
    mesh = GridMesh(resolution)
    check_outputs(out, depth, parameters)
    if pictured:
        check_picture(changed)
    note_raised_bias([(str(parameters), cloth)])
    place = None if capture_set is None else CapturePlan(capture_set, fabric or parameters.stem, cloth, nominal)
    if place is not None:
        place.check()

    from simcore.drape import DrapeStatus
    from simcore.solver import Solver

    with console.progress("simulating"):
        drape = Solver(mesh).solve(
            cloth, changed.setup, seed=seed, mechanics=changed.mechanics, time_limit_s=time_limit
        )
    if drape.status is not DrapeStatus.DIVERGED:
        picture = take_picture(drape, changed, seed) if pictured else None
        with files_written(drape, out, picture, depth):
            if drape.ok and place is not None and picture is not None:
                place.add(picture)
    report(drape, out, json_output)
    if not drape.ok:
        console.error_line(f"the drape is {drape.status}: {drape.reason}", CODE_NOT_STILL)
        raise typer.Exit(1)


def check_options(seed: int, fabric: str | None, capture_set: Path | None) -> None:
    """Refuse options that cannot be or would be passed over.

    Raises:
        InputError: a negative seed, or a fabric's id without a set.
    """
    if seed < 0:
        raise InputError(f"seed {seed} is negative: give 0 or more", code="seed_negative")
    if fabric is not None and capture_set is None:
        raise InputError("--fabric names a fabric of a capture set: give --capture-set too", code="fabric_without_set")


def build_scene(
    name: str,
    effects: list[str],
    cloth: FabricParameters,
    seed: int,
    *,
    pictured: bool,
    pin_radius_m: float | None = None,
) -> tuple[SimulationScene, SimulationScene]:
    """The nominal scene, and the same with the effects on.

    An effect that differs from repeat to repeat is drawn from the seed, the scene and the fabric, unless its own seed
    is given (``bending_hysteresis=magnitude:10,seed:7``).

    Raises:
        InputError: unknown scene or effect, an effect given twice, or magnets that hold more than a quarter of the
            sample.
    """
    from diagnosis.effect import Stage
    from diagnosis.effects import parse_effect
    from diagnosis.scene import SimulationScene
    from services.effect_seed import draw_effect_seed
    from simcore.scenes import Scene, Setup

    setup = Setup.nominal(Scene.parse(name))
    nominal = SimulationScene(setup if pin_radius_m is None else replace(setup, pin_radius_m=pin_radius_m))
    changed = nominal
    seen: set[str] = set()
    for text in effects:
        effect, size = parse_effect(text)
        if effect.random_repeats and not gives_seed(text):
            size[EFFECT_SEED] = draw_effect_seed(effect.name, name, cloth, seed)
        if effect.name in seen:
            raise InputError(f"effect {effect.name} is given twice: give it once", code="effect_twice")
        if effect.stage in (Stage.CAMERA, Stage.SENSOR) and not pictured:
            console.note(f"effect {effect.name} changes the picture alone: ask for one with --depth")
        seen.add(effect.name)
        before, changed = changed, effect.apply(changed, size)
        if said := completed(effect, text, size):
            console.note(f"effect {effect.name}: {said}")
        if changed == before and any(size[name] != 0.0 for name in effect.components):
            console.note(f"effect {effect.name} changes nothing in {setup.scene.value}")
    return nominal, changed


def given_names(text: str) -> set[str]:
    """Components of an effect's size that a command line names; none where it gives one number."""
    parts = text.partition("=")[2].split(",")
    return {part.partition(":")[0].strip() for part in parts if ":" in part}


def gives_seed(text: str) -> bool:
    """Whether a size from the command line says the effect's own seed."""
    return EFFECT_SEED in given_names(text)


def completed(effect: Effect, text: str, size: Mapping[str, float]) -> str:
    """The whole size in words, where a command line gives a part of it: nothing where the rest is zero or chance."""
    named = given_names(text)
    if effect.vector and named:
        return ""
    first = next(iter(effect.components))
    left = set(size) - (named or {first}) - ({EFFECT_SEED} if effect.random_repeats else set())
    if not left:
        return ""
    shown = [f"{name} {value:.4g}" for name, value in size.items() if name in left or name in named or name == first]
    return ", ".join(shown) + f" [{effect.unit}]" * effect.vector


def report(drape: Drape, out: Path, json_output: bool) -> None:
    """Print how it went."""
    from simcore.drape import DrapeStatus

    if json_output:
        console.emit_json({name: getattr(drape, name) for name in RESULT_NAMES})
        return
    written = "" if drape.status is DrapeStatus.DIVERGED else f" -> {out}"
    console.say(
        f"{drape.status}: residual {drape.residual:.1e} vertex weights, energy {drape.energy:.6g} J, "
        f"{drape.iterations} iterations, {drape.seconds:.2f} s{written}"
    )
