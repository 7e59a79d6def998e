"""`drapemeter diagnose`: where simulation and captures part, and why."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from services import console
from services.cli.caches import drape_cache
from services.cli.options import JSON, SEED_FIXED
from services.cli.outputs import check_file, check_folder, make_folder
from services.names import split_names
from services.plain_json import to_plain
from simcore.errors import InputError

if TYPE_CHECKING:
    from capture.capture_set import CaptureSet
    from diagnosis.atlas import PartSolver
    from diagnosis.diagnose import Diagnosis, DiagnosisOptions
    from diagnosis.isolability import Isolability
    from diagnosis.separation import Separation
    from diagnosis.simulation.drape_cache import DrapeCache


REPORT, PAGE, ISOLABILITY, SIMULATOR = "report.json", "report.html", "isolability.json", "simulator.json"
"""What is written into the folder of a report."""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("diagnose")(diagnose)


def diagnose(
    capture_set: Path = typer.Argument(..., help="Capture set: a folder with captures.json."),
    out: Path = typer.Option(..., "--out", help="Folder for report.json and report.html; made if absent."),
    effects: str = typer.Option("", "--effects", help="Try only these, comma-separated; default: the catalogue."),
    without: str = typer.Option("", "--without", help="Leave these effects out, comma-separated."),
    resolution: float = typer.Option(0.01, "--resolution", help="Edge of a mesh cell [m]."),
    workers: int = typer.Option(
        1,
        "--workers",
        help="Processes; each takes a fabric at a time, with --build-atlas a fold state; --isolability uses one.",
    ),
    isolability: bool = typer.Option(
        False, "--isolability", help="Only say which effects such captures can tell apart (isolability.json)."
    ),
    apply: bool = typer.Option(
        False, "--apply", help="Also write simulator.json: the effects found, for `drapemeter dataset --simulator`."
    ),
    atlas: Path | None = typer.Option(None, "--atlas", help="Folder of simulations; default: the user's cache."),
    build_atlas: bool = typer.Option(False, "--build-atlas", help="Only simulate what does not depend on pictures."),
    address: str | None = typer.Option(
        None,
        "--address",
        help="With --build-atlas: a running Ray cluster that simulates (auto, host:port, ray://host:port).",
    ),
    afresh: bool = typer.Option(True, help="Simulate what may be named at its fitted size and judge again."),
    lpips: bool = typer.Option(True, help="Say how far the gap shrinks in LPIPS drape distance, too."),
    seed: int = SEED_FIXED,
    json_output: bool = JSON,
) -> None:
    """Compare captures with simulations of the same fabrics; name the effect that the simulation lacks.

    Writes report.json (format drape-gap-report/1) and report.html, one page with pictures. The simulations are kept in
    the cache folder (DRAPEMETER_CACHE) or in an atlas, so a second run is short.

    \b
    Example:
      drapemeter diagnose my-captures --out report/ --workers 2
      drapemeter diagnose my-captures --out report/ --isolability
      drapemeter diagnose my-captures --out report/ --build-atlas --atlas atlas/ --workers 2
    """
    from capture.capture_set import CaptureSet
    from diagnosis.atlas import open_atlas
    from diagnosis.diagnose import DiagnosisOptions
    from diagnosis.tasks.meshing import check_resolution

    _check_out(out, apply=apply)
    if workers < 1:
        raise InputError(f"{workers} workers: give 1 or more", code="workers")
    _check_modes(isolability, build_atlas, apply, address)
    check_resolution(resolution)
    tried = split_names(effects)
    if effects and not tried:
        raise InputError(f"--effects {effects!r} names none: give names, or leave it away", code="no_effects")
    options = DiagnosisOptions(tried, split_names(without), resolution, workers, afresh, lpips)
    options.chosen()
    captures = CaptureSet.load(capture_set, read_pictures=not (isolability or build_atlas))
    if atlas is not None:
        check_folder(atlas, "give --atlas another folder")
    cache = drape_cache() if atlas is None else open_atlas(atlas)
    if build_atlas:
        _build(captures, options, cache, address, json_output)
    elif isolability:
        _isolability(captures, options, cache, out, json_output)
    else:
        _diagnose(captures, options, cache, out, apply, json_output)


def _check_out(out: Path, *, apply: bool) -> None:
    """Refuse a folder that could not take the report later.

    Raises:
        InputError: it is a file, cannot be made or written to, holds folders where the files go, or a file of
            somebody's where the simulator file goes.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} is a file: give a folder for the report", code="output_is_file")
    check_folder(out, "give another folder for the report")
    for name in (REPORT, PAGE, ISOLABILITY, SIMULATOR):
        check_file(out / name)
    if apply and (out / SIMULATOR).exists() and not _is_own(out / SIMULATOR):
        raise InputError(
            f"{out / SIMULATOR} is there and no simulator file: give another folder, or take it away",
            code="output_in_use",
        )


def _is_own(path: Path) -> bool:
    """Whether a simulator file is there, whatever effects it has; anything else of that name is somebody's."""
    from diagnosis.extension import FORMAT

    try:
        found = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(found, dict) and found.get("format") == FORMAT


def _check_modes(isolability: bool, build_atlas: bool, apply: bool, address: str | None) -> None:
    """Refuse options of which one would be passed over.

    Raises:
        InputError: two that exclude each other, or a cluster for what runs here.
    """
    if address is not None and not build_atlas:
        raise InputError("--address is for --build-atlas: a diagnosis itself runs here, on --workers", code="address")
    if isolability and build_atlas:
        raise InputError("give --isolability or --build-atlas, one after the other", code="options_exclude")
    if apply and (isolability or build_atlas):
        raise InputError("--apply writes what a diagnosis found: leave it out here", code="options_exclude")


def _diagnose(
    captures: CaptureSet, options: DiagnosisOptions, cache: DrapeCache, out: Path, apply: bool, json_output: bool
) -> None:
    from diagnosis.diagnose import diagnose as run
    from diagnosis.extension import SimulatorExtension
    from diagnosis.pages.html import render_html
    from diagnosis.pages.sentence import sentence
    from renderer.atomic import write_atomically
    from services.cli.diagnose_apply import doubts, held_m

    with console.progress("diagnosing", total=100) as bar:
        show = partial(_show, bar)
        found = run(captures, options, cache=cache, on_step=show, on_forecast=console.note)
    make_folder(out, "give another folder for the report")
    earlier = (out / REPORT).exists()
    page = render_html(found, captures.document.name or captures.folder.resolve().name)
    found = found.recounted()
    cache.trim()
    write_atomically(out / PAGE, page.encode())
    document = found.report.as_json()
    write_atomically(out / REPORT, (json.dumps(to_plain(document), indent=1, allow_nan=False) + "\n").encode())
    if apply:
        made = SimulatorExtension.of(found.report, held_m(found))
        made.save(out / SIMULATOR)
        for line in doubts(made, found):
            console.note(f"{out / SIMULATOR}: {line}")
    elif _is_own(out / SIMULATOR) and earlier:
        (out / SIMULATOR).unlink()
        console.note(f"{out / SIMULATOR} was of an earlier report and is gone: --apply writes this one's")
    elif (out / SIMULATOR).exists():
        console.note(f"{out / SIMULATOR} is of no report here and stays as it is")
    if json_output:
        console.emit_json(document)
        return
    console.say(sentence(found))
    _say_probabilities(found)
    console.say(f"{out / REPORT}, {out / PAGE}")


def _show(bar: console.ProgressBar, done: float, what: str) -> None:
    bar.update(completed=round(100 * done), total=100, description=f"diagnosing, {what}")


def _say_probabilities(found: Diagnosis) -> None:
    from diagnosis.pages.html import size_text

    for name, p in sorted(found.report.cause.probabilities.items(), key=lambda item: -item[1])[:5]:
        console.say(f"  {name:20s} {p:.3f}")
    for effect in found.report.cause.effects:
        console.say(f"size of {effect.name}: {size_text(effect)}")
    if found.report.cause.not_separable_from:
        console.say(f"not separable from: {', '.join(found.report.cause.not_separable_from)}")


def _build(
    captures: CaptureSet, options: DiagnosisOptions, cache: DrapeCache, address: str | None, json_output: bool
) -> None:
    from diagnosis.atlas import build_atlas, solve_here
    from diagnosis.atlas_part import atlas_parts

    if cache.folder is None:
        raise InputError("DRAPEMETER_CACHE is empty, so nothing would be kept: give --atlas", code="atlas_missing")
    solve: PartSolver = solve_here
    if address is not None or options.workers > 1:
        from services.dataset.atlas import solver_on_ray

        # a cluster's workers are all taken; on this machine, so many as were asked for
        solve = solver_on_ray(address, options.workers if address is None else None)
    parts = atlas_parts(captures, options.chosen(), options.resolution_m)
    with console.progress("simulating", total=len(parts)) as bar:
        cost = build_atlas(parts, cache, bar.advance, solve)
    if json_output:
        console.emit_json({"simulations": cost.simulations, "seconds": cost.seconds, "cached": cost.cached})
        return
    console.say(f"{cost.simulations} simulations in {cost.seconds:.0f} CPU seconds, {cost.cached} were there")


def _isolability(
    captures: CaptureSet, options: DiagnosisOptions, cache: DrapeCache, out: Path, json_output: bool
) -> None:
    from diagnosis.isolability import analyse
    from diagnosis.remedies import remedy
    from renderer.atomic import write_atomically

    with console.progress("simulating", total=_shown(captures)) as bar:
        found = analyse(captures, options.chosen(), options.resolution_m, cache, bar.advance)
    document = _isolability_json(found)
    make_folder(out, "give another folder for the report")
    write_atomically(out / ISOLABILITY, (json.dumps(document, indent=1) + "\n").encode())
    if json_output:
        console.emit_json(document)
        return
    console.say(f"not visible in {', '.join(found.scenes)}: {', '.join(found.invisible()) or 'none'}")
    if found.left_out:
        console.say(f"left out, another one in every repeat: {', '.join(found.left_out)}")
    console.say("effects of typical size that such captures cannot tell apart:")
    for pair in found.confused():
        if pair.effect not in found.invisible():
            what = remedy(pair.effect, pair.other, found)
            console.say(f"  {pair.effect:20s} as {pair.other:20s} {pair.share:.2f} left; {what}")
    for line in found.assumed:
        console.say(f"assumed: {line}")
    console.say(f"{out / ISOLABILITY}")


def _isolability_json(found: Isolability) -> dict[str, Any]:
    from diagnosis.remedies import remedy
    from diagnosis.separation import SEPARABLE_NATS

    def row(pair: Separation) -> dict[str, Any]:
        key = (pair.effect, pair.other)
        scenes = {scene: nats[key] for scene, nats in found.by_scene.items() if key in nats}
        said = {"effect": pair.effect, "as": pair.other, "share_left": pair.share, "nats": pair.nats}
        return {**said, "nats_by_scene": scenes}

    return {
        "format": "drape-isolability/1",
        "scenes": list(found.scenes),
        "threshold_nats": SEPARABLE_NATS,
        "invisible": list(found.invisible()),
        "left_out": list(found.left_out),
        "confused": [{**row(p), "separated_by": remedy(p.effect, p.other, found)} for p in found.confused()],
        "pairs": [row(p) for p in found.pairs],
        "assumed": list(found.assumed),
    }


def _shown(captures: CaptureSet) -> int:
    return len({capture.fabric.id for capture in captures.captures})
