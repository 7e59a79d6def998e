"""`drapemeter simulate`: one fabric, one scene, one drape."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from services.cli import console
from simcore.errors import InputError

if TYPE_CHECKING:
    from simcore.drape import Drape

CODE_NOT_STILL = "drape_not_still"


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("simulate")(simulate)


def simulate(
    scene: str = typer.Option(..., "--scene", help="hanging or stretch."),
    parameters: Path = typer.Option(..., "--parameters", help="JSON file with the seven fabric parameters, SI."),
    out: Path = typer.Option(..., "--out", help="The drape: PLY, float64, metres, panel frame."),
    resolution: float = typer.Option(0.005, "--resolution", help="Edge of a mesh cell [m]; must divide 0.5 m."),
    seed: int = typer.Option(0, "--seed", help="Of the jitter: the same seed gives the same bits."),
    depth: Path | None = typer.Option(None, "--depth", help="Also a 16-bit depth PNG (256 x 256, 0.1 mm a count)."),
    json_output: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    """Bring one fabric to rest in one scene; write the drape and, if asked, its depth picture.

    Exits 0 when the drape is still: certified, at rest. Otherwise it exits 1, the status and its reason say why
    (not_still, under_resolved), and the files hold the best that was reached; of a diverged one nothing is written.

    \b
    Example:
      drapemeter simulate --scene hanging --parameters p.json --resolution 0.01 --out drape.ply --depth d.png
    """
    from simcore.mesh import GridMesh
    from simcore.parameters import FabricParameters
    from simcore.scenes import Scene, Setup

    setup = Setup.nominal(Scene.parse(scene))
    fabric = FabricParameters.load(parameters)
    mesh = GridMesh(resolution)
    check_output(out)
    if depth is not None:
        check_output(depth)
        if depth.absolute() == out.absolute():
            raise InputError(f"{out} cannot be both the drape and its depth picture", code="output_twice")
    if seed < 0:
        raise InputError(f"seed {seed} is negative: give 0 or more", code="seed_negative")

    from simcore.drape import DrapeStatus
    from simcore.solver import Solver

    drape = Solver(mesh).solve(fabric, setup, seed=seed)
    if drape.status is not DrapeStatus.DIVERGED:
        write(drape, out, depth)
    report(drape, out, json_output)
    if not drape.ok:
        console.error_line(f"the drape is {drape.status}: {drape.reason}", CODE_NOT_STILL)
        raise typer.Exit(1)


def check_output(path: Path) -> None:
    """Refuse early what could not be written later.

    Raises:
        InputError: the folder is not there, or the path is a folder.
    """
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: its folder does not exist; make it first", code="folder_missing")
    if path.is_dir():
        raise InputError(f"{path} is a folder: name a file", code="output_is_folder")


def write(drape: Drape, out: Path, depth: Path | None) -> None:
    """Write the mesh and the depth picture as the canonical camera sees it; each file whole or not at all."""
    from renderer.ply import write_ply

    picture = None
    if depth is not None:
        from renderer.camera import CANONICAL_CAMERA, frontal_pose
        from renderer.depth import render_depth

        picture = render_depth(drape.vertices, drape.mesh.triangles, CANONICAL_CAMERA, frontal_pose())
    write_ply(out, drape.vertices, drape.mesh.triangles)
    if depth is not None and picture is not None:
        from renderer.depth_png import write_depth_png

        write_depth_png(depth, picture)


def report(drape: Drape, out: Path, json_output: bool) -> None:
    """Print how it went."""
    if json_output:
        names = ("status", "residual", "energy", "stable", "iterations", "seconds", "reason")
        console.emit_json({name: getattr(drape, name) for name in names})
        return
    console.say(
        f"{drape.status}: residual {drape.residual:.1e} vertex weights, energy {drape.energy:.6g} J, "
        f"{drape.iterations} iterations, {drape.seconds:.2f} s -> {out}"
    )
