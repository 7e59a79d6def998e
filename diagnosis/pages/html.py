"""The report as one self-contained HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.fresh import is_finite
from diagnosis.diagnose import Diagnosis
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block
from diagnosis.inference.cause import Cause
from diagnosis.measurement.reference import CELLS, heights
from diagnosis.pages.advice import advice
from diagnosis.pages.sentence import sentence
from diagnosis.pages.where_figure import SURE, png_text, where_picture
from diagnosis.report import FoundEffect
from diagnosis.shrinkage.held_out import Judge, refit, sized
from diagnosis.shrinkage.seen_depth import seen
from diagnosis.tasks.fabric_task import CaptureResult, CaptureTask

TEMPLATE = Path(__file__).parent / "templates" / "report.html.j2"
MOST_PICTURES = 12
"""Six fabrics in both scenes; a page of more would take long to load."""
REPEATS_SHOW = 1.02
"""Scatter of repeats above the noise floor by more than this is drawn beside it."""
WITHIN = 0.995
"""Share of a picture's heights that are told apart by its colours; single wrong readings do not set them."""
TEXTS = {
    "none": "nothing beyond repeats and stated uncertainties",
    "unknown": "something that no effect that was tried describes",
}


def render_html(diagnosis: Diagnosis, name: str) -> str:
    """The page, pictures embedded."""
    from jinja2 import Environment

    environment = Environment(autoescape=True)
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    pictures = _pictures(diagnosis)
    report = diagnosis.recounted().report
    ordered = sorted(report.cause.probabilities.items(), key=lambda item: -item[1])
    causes = [{"name": n, "p": p, "text": TEXTS.get(n) or get_effect(n).summary} for n, p in ordered[:8]]
    return template.render(
        name=name,
        report=report,
        causes=causes,
        sizes=[f"{effect.name}: {size_text(effect)}" for effect in report.cause.effects],
        sentence=sentence(diagnosis),
        todo=advice(diagnosis),
        pictures=pictures,
        where=_where(diagnosis),
        sure=SURE,
        assumed=diagnosis.assumed,
        bars=_bars(diagnosis),
        scatter="repeats scatter by" if _has_repeats(diagnosis) else "errors are expected to make",
    )


def size_text(effect: FoundEffect) -> str:
    """A size with its 90 % interval to three digits, lengths in millimetres and shares in per cent, and its place; a
    vector component by component."""
    plain = (100.0, " %") if get_effect(effect.name).share else (1.0, "")
    factor, unit = {"m": (1e3, " mm"), "1": plain}.get(effect.unit, (1.0, f" {effect.unit}"))
    size, interval = effect.magnitude, effect.interval_90
    sizes = size if isinstance(size, dict) else {"": size}
    ends = interval if isinstance(interval, dict) else {"": interval}
    texts = []
    for name, value in sizes.items():
        low, high = (factor * end for end in ends[name])
        texts.append(f"{name} {factor * value:.3g}{unit} (90 % interval {low:.3g} to {high:.3g})".strip())
    place = {} if get_effect(effect.name).random_repeats else effect.place
    return ", ".join([*texts, *(f"{name} {value:.3g}" for name, value in place.items())])


def _bars(diagnosis: Diagnosis) -> list[tuple[str, float, str]]:
    """Name, length and colour of the shrinkage's bars."""
    found = diagnosis.report.shrinkage
    if found is None:
        return []
    bars = [("before", found.before, "#2b6cb0"), ("after", found.after, "#38a169")]
    if found.control is not None and set(found.control.effects) != {"none"}:
        bars.append(("wrong effect", found.control.after, "#a0aec0"))
    bars.append(("noise floor", found.noise_floor, "#cbd5e0"))
    if found.repeats is not None and found.repeats > REPEATS_SHOW * found.noise_floor:  # nearer than repeats lie
        bars.append(("repeats" if _has_repeats(diagnosis) else "expected errors", found.repeats, "#e2e8f0"))
    return bars


def _has_repeats(diagnosis: Diagnosis) -> bool:
    """What is held out was captured twice; what is told as the scatter of repeats is that of the model otherwise."""
    found = diagnosis.report.shrinkage
    if found is not None and found.unit != "mm":
        return False
    scenes = {block.scene for block in diagnosis.blocks}
    judged = "stretch" if "stretch" in scenes else "hanging"
    return any(block.repeated for block in diagnosis.blocks if block.scene == judged)


def _where(diagnosis: Diagnosis) -> list[dict[str, str]]:
    """A picture of every scene's rows."""
    scenes = sorted({block.scene for block in diagnosis.blocks}, reverse=True)
    rows = diagnosis.report.where
    return [{"title": scene, "data": where_picture(scene, diagnosis.blocks, rows)} for scene in scenes]


def _pictures(diagnosis: Diagnosis) -> list[dict[str, str]]:
    """The first capture of every fabric and scene, :data:`MOST_PICTURES` at most: ``stretch`` of all fabrics first."""
    firsts = {
        (scene, number): next((c for c in result.captures if c.scene == scene), None)
        for scene in ("stretch", "hanging")
        for number, result in enumerate(diagnosis.results)
    }
    chosen = [key for key, capture in firsts.items() if capture is not None][:MOST_PICTURES]
    pictures: list[dict[str, str]] = []
    for scene, number in sorted(chosen, key=lambda key: key[1]):
        capture, result = firsts[scene, number], diagnosis.results[number]
        assert capture is not None
        task = next(t for t in result.task.captures if t.id == capture.id)
        block = next(b for b in diagnosis.blocks if b.fabric == capture.fabric and b.scene == scene)
        data = _picture(task, capture, _after(diagnosis, capture), _maps(block, diagnosis))
        pictures.append({"title": capture.id, "data": data})
    return pictures


def _after(diagnosis: Diagnosis, capture: CaptureResult) -> NDArray[np.float32] | None:
    """Simulation with the named effects on, seen through camera and sensor without noise [m]; None where nothing is
    named, nothing is simulated afresh, it diverges, or a picture shows nothing of it: scatter and noise."""
    look, effects = diagnosis.looks.get(capture.fabric), sized(diagnosis.cause)
    if look is None or not _shifts(diagnosis.cause) or not is_finite(look.drape(capture, effects)):
        return None
    after = seen(look, capture, effects)
    return None if np.array_equal(after, capture.reference.depth) else after


def _shifts(cause: Cause) -> bool:
    """Something is named that changes all repeats alike."""
    return any(not get_effect(name).random_repeats for name in cause.named)


def _maps(block: Block, diagnosis: Diagnosis) -> list[tuple[str, NDArray[np.float64]]]:
    """Difference in each cell of the cloth of the first capture, parameters refitted [mm], without and with the effect.

    Simulated afresh as the picture beside it is, where that comes to rest. Maps are [cells, cells], row by row down the
    sample, whatever its shape in the picture.
    """
    cause = diagnosis.cause
    response = Judge(diagnosis.looks).response(block, sized(cause))
    shown = [("left over without an effect [mm]", np.zeros_like(response))]
    if _shifts(cause):
        shown.append((f"with {' and '.join(cause.named)} [mm]", response))
    maps = []
    for title, taken in shown:
        left = refit(block, taken).left
        own = (block.owner == 0) & (block.cell < CELLS * CELLS)
        table = np.full(CELLS * CELLS, np.nan)
        table[block.cell[own]] = -1e3 * left[own]
        maps.append((title, table.reshape(CELLS, CELLS)))
    return maps


def _picture(
    task: CaptureTask,
    found: CaptureResult,
    after: NDArray[np.float32] | None,
    maps: list[tuple[str, NDArray[np.float64]]],
) -> str:
    """Capture, simulation before and after, difference, and what is left on the cloth's own cells; PNG in base64."""
    from matplotlib.figure import Figure

    rows, columns = np.nonzero(found.reference.cell >= 0)
    window = (slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1))
    depth, simulated = task.depth[window].astype(float), found.reference.depth[window].astype(float)
    difference = 1e3 * np.where((depth > 0) & (simulated > 0), simulated - depth, np.nan)

    def height(picture: NDArray[np.float32]) -> NDArray[np.float64]:
        return 1e3 * heights(picture, task.scene)[window]

    shown = [
        (height(task.depth), "capture, height [mm]"),
        (height(found.reference.depth), "simulation without effect [mm]"),
    ]
    if after is not None:
        shown.append((height(after), "simulation with what was found [mm]"))
    ends = np.array([np.nanquantile(values, (1.0 - WITHIN, WITHIN)) for values, _ in shown])
    low, high = min(0.0, float(ends.min())), float(ends.max())
    figure = Figure(figsize=(4.0 * (len(shown) + 1 + len(maps)), 4), layout="constrained")
    axes: Any = figure.subplots(1, len(shown) + 1 + len(maps))
    for axis, (values, title) in zip(axes, shown, strict=False):
        drawn = axis.imshow(values, vmin=low, vmax=high, cmap="viridis")
        axis.set_title(title)
        figure.colorbar(drawn, ax=axis, shrink=0.8)
    most = max(2.0, float(np.nanquantile(np.abs(difference), 0.98)))
    apart = axes[len(shown)]
    drawn = apart.imshow(difference, vmin=-most, vmax=most, cmap="RdBu_r")
    apart.set_title("capture nearer (red) or farther (blue) [mm]")
    figure.colorbar(drawn, ax=apart, shrink=0.8)
    most = max(1.0, float(np.nanquantile(np.abs(maps[0][1]), 0.98)))
    for axis, (title, table) in zip(axes[len(shown) + 1 :], maps, strict=True):
        drawn = axis.imshow(table, vmin=-most, vmax=most, cmap="RdBu_r")
        axis.set_title(title)
        figure.colorbar(drawn, ax=axis, shrink=0.8)
    for axis in axes:
        axis.set_axis_off()
    return png_text(figure)
