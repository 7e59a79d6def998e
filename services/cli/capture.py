"""`drapemeter capture`: check, register, import and record capture sets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from services import console
from services.cli.options import JSON, SEED_FIXED, SEED_UNUSED
from services.cli.outputs import check_folder, make_folder
from services.plain_json import to_plain

if TYPE_CHECKING:
    from capture.addition import NewCapture
    from capture.report import CaptureReport
    from capture.sources import DepthSource

OVERVIEW = """Record, import and check capture sets: folders with captures.json and depth pictures.

\b
Example:
  drapemeter capture check my-captures
"""

FABRIC = typer.Option(..., "--fabric", help="Id of the fabric; added to the set if it is new.")
SCENE = typer.Option(..., "--scene", help="hanging or stretch.")
DENSITY = typer.Option(None, "--density", help="Of the fabric [kg/m2]; a set that has it states the same.")
SAMPLE = typer.Option(None, "--sample-size", help="Edge of the square sample [m]; default: the set's; 0.5 if new.")
PANEL = typer.Option(None, "--panel/--no-panel", help="A panel stands behind it; default: as in the set; yes if new.")
OTHER_SET = "give another folder for the capture set"
FRAMES = typer.Option(30, "--frames", min=1, help="Frames to take the median of.")


def register(app: typer.Typer) -> None:
    """Add the command group."""
    group = typer.Typer(help=OVERVIEW, rich_markup_mode=None)
    group.command("check")(check)
    group.command("register")(register_set)
    group.command("import")(import_frames)
    group.command("record")(record)
    group.command("schema")(schema)
    app.add_typer(group, name="capture")


def check(
    capture_set: Path = typer.Argument(..., metavar="SET", help="Folder with captures.json."),
    seed: int = SEED_FIXED,
    json_output: bool = JSON,
) -> None:
    """Check a capture set and tell what is seen in each picture: cloth, holes, noise, panel, pose.

    \b
    Example:
      drapemeter capture check my-captures
      drapemeter capture check my-captures --json
    """
    from capture.capture_set import CaptureSet
    from capture.prepare import prepare_all
    from capture.report import report_capture

    found = CaptureSet.load(capture_set)
    reports = []
    with console.progress("looking", len(found.captures)) as bar:
        for prepared in prepare_all(found.captures):
            reports.append(report_capture(prepared))
            bar.advance()
    if json_output:
        console.emit_json(
            {
                "name": found.document.name,
                "fabrics": [
                    {"id": f.id, "density": f.density, "parameters_given": f.parameters is not None}
                    for f in found.document.fabrics
                ],
                "captures": reports,
            }
        )
        return
    for line in _table(reports):
        console.say(line)


def register_set(
    capture_set: Path = typer.Argument(..., metavar="SET", help="Folder with captures.json."),
    out: Path = typer.Option(..., "--out", help="Folder for one picture a capture and poses.json."),
    seed: int = SEED_FIXED,
    json_output: bool = JSON,
) -> None:
    """Find the cloth and the camera's pose; write pictures of the mask and of the registered height.

    \b
    Example:
      drapemeter capture register my-captures --out registered
    """
    import json

    from capture.capture_set import CaptureSet
    from capture.figures import draw_registration
    from capture.prepare import prepare_all
    from capture.report import report_capture
    from renderer.atomic import write_atomically

    check_folder(out, "give another folder for the pictures")
    found = CaptureSet.load(capture_set)
    prepared_captures = list(prepare_all(found.captures))  # all are found before anything is written
    make_folder(out, "give another folder for the pictures")
    earlier, drawn, reports = _earlier_pictures(out), [], []
    with console.progress("drawing", len(prepared_captures)) as bar:
        for number, prepared in enumerate(prepared_captures):
            drawn.append(out / _picture_name(number, prepared.capture.id))
            draw_registration(prepared, drawn[-1])
            reports.append(report_capture(prepared))
            bar.advance()
    poses = {"captures": to_plain(reports)}
    write_atomically(out / "poses.json", (json.dumps(poses, indent=1) + "\n").encode())
    for picture in set(earlier) - set(drawn):
        picture.unlink(missing_ok=True)
    if json_output:
        console.emit_json({"out": out, **poses})
        return
    for line in _table(reports):
        console.say(line)
    console.say(f"pictures and poses.json are in {out}")


def _picture_name(number: int, capture_id: str) -> str:
    from capture.addition import file_name

    return f"{number:03d}-{file_name(capture_id)}.png"


def _earlier_pictures(folder: Path) -> list[Path]:
    """Pictures of an earlier set there, which its ``poses.json`` lists."""
    import json

    try:
        listed = json.loads((folder / "poses.json").read_text(encoding="utf-8"))["captures"]
        return [folder / _picture_name(number, str(capture["id"])) for number, capture in enumerate(listed)]
    except (OSError, ValueError, LookupError, TypeError):
        return []


def import_frames(
    source: Path = typer.Argument(..., metavar="SOURCE", help="Folder of depth PNG files, or a .bag or .db3 file."),
    out: Path = typer.Option(..., "--out", help="Capture set to add to; made if it is not there."),
    fabric: str = FABRIC,
    scene: str = SCENE,
    camera: Path | None = typer.Option(
        None, "--camera", help="JSON with width, height, fx, fy, cx, cy, depth_unit_m; for PNG files."
    ),
    density: float | None = DENSITY,
    sample_size: float | None = SAMPLE,
    panel: bool | None = PANEL,
    frames: int = FRAMES,
    seed: int = SEED_UNUSED,
    json_output: bool = JSON,
) -> None:
    """Add one capture made of the frames of a still scene (their median over time).

    \b
    Example:
      drapemeter capture import frames/ --camera camera.json --fabric denim --scene hanging --out my-captures
      drapemeter capture import denim.db3 --fabric denim --scene stretch --density 0.35 --out my-captures
    """
    from capture.realsense import RECORDING_SUFFIXES, RealSenseSource
    from capture.sources import PngFolderSource, load_camera
    from simcore.errors import InputError

    check_folder(out, OTHER_SET)
    new = _new_capture(fabric, scene, density, sample_size, panel)
    opened: DepthSource
    if not source.exists():
        raise InputError(f"{source}: no such folder or recording", code="file_missing")
    if source.is_file():
        if source.suffix.lower() not in RECORDING_SUFFIXES:
            raise InputError(
                f"{source}: give the folder that holds the 16-bit depth PNG files, or a RealSense recording "
                f"({' or '.join(RECORDING_SUFFIXES)})",
                code="recording_unusable",
            )
        if camera is not None:
            raise InputError(
                f"{source} is a recording, which holds its camera: leave --camera away", code="camera_not_needed"
            )
        opened = RealSenseSource(source)
    elif camera is None:
        raise InputError(
            "a folder of PNG files says nothing of its camera: give --camera camera.json", code="camera_needed"
        )
    else:
        opened = PngFolderSource(source, load_camera(camera))
    _record(opened, out, new, frames, json_output)


def record(
    out: Path = typer.Option(..., "--out", help="Capture set to add to; made if it is not there."),
    fabric: str = FABRIC,
    scene: str = SCENE,
    serial: str | None = typer.Option(None, "--serial", help="Of the camera, where several are connected."),
    density: float | None = DENSITY,
    sample_size: float | None = SAMPLE,
    panel: bool | None = PANEL,
    frames: int = FRAMES,
    seed: int = SEED_UNUSED,
    json_output: bool = JSON,
) -> None:
    """Take one capture with a connected RealSense camera.

    \b
    Example:
      drapemeter capture record --fabric denim --scene hanging --density 0.35 --out my-captures
    """
    from capture.realsense import RealSenseSource

    check_folder(out, OTHER_SET)
    new = _new_capture(fabric, scene, density, sample_size, panel)
    _record(RealSenseSource(serial=serial), out, new, frames, json_output)


def schema(seed: int = SEED_UNUSED, json_output: bool = JSON) -> None:
    """Print the JSON Schema of captures.json; it is one JSON document with --json and without.

    \b
    Example:
      drapemeter capture schema > capture-set.schema.json
    """
    from capture.documents import json_schema

    console.emit_json(json_schema())


def _new_capture(
    fabric: str, scene: str, density: float | None, sample_size: float | None, panel: bool | None
) -> NewCapture:
    """What was said of the capture; what was not said is the set's."""
    from capture.addition import NewCapture
    from simcore.scenes import Scene, Setup

    setup: dict[str, Any] = {}
    if sample_size is not None:
        Setup.nominal(scene, sample_size_m=(sample_size, sample_size))  # says what is wrong with it
        setup["sample_size_m"] = [sample_size, sample_size]
    if panel is not None:
        setup["panel"] = panel
    return NewCapture(fabric, Scene.parse(scene).value, density, setup)


def _record(source: DepthSource, out: Path, new: NewCapture, frames: int, json_output: bool) -> None:
    from capture.record import record_capture

    notes: list[str] = []
    with source:
        name = record_capture(source, out, new, frames=frames, tell=notes.append)
    if json_output:
        console.emit_json({"capture": name, "out": out, "notes": notes})
    else:
        for note in notes:
            console.say(f"{name}: {note}")
        console.say(f"{name} was added to {out}; `drapemeter capture check {out}` tells what is seen in it")


def _table(reports: list[CaptureReport]) -> list[str]:
    header = f"{'capture':20} {'cloth':>7} {'stands out':>10} {'holes':>6} {'noise':>7} {'panel rms':>9}  pose"
    lines = [header]
    for r in reports:
        panel = "none" if r.panel is None else f"{1e3 * r.panel.rms_m:.1f} mm"
        pins = "" if r.pin_error_m is None else f", pins off {1e3 * r.pin_error_m:.0f} mm"
        lines.append(
            f"{r.id:20} {100 * r.cloth_share:5.0f} % {100 * r.standing_share:8.0f} % {100 * r.holes:4.0f} % "
            f"{1e3 * r.noise_m:4.1f} mm {panel:>9}  {r.pose_from.replace('_', ' ')}, "
            f"turned {r.camera_turned_deg:.1f} deg{pins}"
        )
        lines.extend(f"  ! {warning}" for warning in r.warnings)
    return lines
