"""The step that diagnoses: captures with a draft that the diagnosis is not told of."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from capture.capture_set import CaptureSet
from diagnosis.atlas import build_atlas, open_atlas
from diagnosis.atlas_part import atlas_parts
from diagnosis.diagnose import DiagnosisOptions, diagnose
from diagnosis.effects import get_effect
from diagnosis.pages.html import render_html
from diagnosis.pages.sentence import sentence
from diagnosis.scene import SimulationScene
from renderer.atomic import write_atomically
from services.dataset.atlas import solver_on_ray
from services.demo import fabrics
from services.demo.captures import simulate_captures
from simcore.scenes import Scene, Setup

EFFECT, MAGNITUDE = "air_draft", 0.1
CANDIDATES: tuple[str, ...] = ("air_draft", "depth_scale", "pin_spacing")
FABRICS: tuple[str, ...] = ("poplin", "twill", "canvas")


@dataclass(frozen=True)
class GapSummary:
    """What the diagnosis said.

    Attributes:
        sentence: in plain words.
        effect, magnitude, unit: what the captures were made with.
        candidates: effects that were tried, besides none and unknown.
        top: what was named.
        probabilities: of every candidate, none and unknown.
        fraction: share of the gap that the effect closed on held-out captures; None where none was named.
        atlas, solved: simulations that were made before any picture was looked at, and those that were left.
    """

    sentence: str
    effect: str
    magnitude: float
    unit: str
    candidates: tuple[str, ...]
    top: str
    probabilities: dict[str, float]
    fraction: float | None
    atlas: int
    solved: int


def drafty_captures(
    folder: Path, *, repeats: int, resolution_m: float, seed: int, on_done: Callable[[], None] | None = None
) -> None:
    """Simulate captures of a few fabrics in a draft; their ordinary parameters are stated, the draft is not."""
    changed = get_effect(EFFECT).apply(SimulationScene(Setup.nominal(Scene.HANGING)), MAGNITUDE)
    simulate_captures(
        folder,
        {name: fabrics.NAMED[name] for name in FABRICS},
        repeats=repeats,
        resolution_m=resolution_m,
        seed=seed,
        mechanics=changed.mechanics,
        state_parameters=True,
        on_done=on_done,
    )


def explain(captures: Path, atlas_folder: Path, report: Path, *, resolution_m: float, workers: int) -> GapSummary:
    """Build the captures' atlas on Ray, into a folder, and diagnose with it; write the report into another."""
    options = DiagnosisOptions(effects=CANDIDATES, resolution_m=resolution_m, workers=workers)
    cache, shown = open_atlas(atlas_folder), CaptureSet.load(captures)
    parts = atlas_parts(shown, options.chosen(), resolution_m)
    atlas = build_atlas(parts, cache, solve=solver_on_ray(None, workers))
    found = diagnose(shown, options, cache=cache)
    report.mkdir(exist_ok=True)
    page = render_html(found, captures.name)
    found = found.recounted()
    document = found.report.as_json()
    write_atomically(report / "report.json", (json.dumps(document, indent=1) + "\n").encode())
    write_atomically(report / "report.html", page.encode())
    shrinkage = document["shrinkage"]
    return GapSummary(
        sentence=sentence(found),
        effect=EFFECT,
        magnitude=MAGNITUDE,
        unit=get_effect(EFFECT).unit,
        candidates=CANDIDATES,
        top=found.report.cause.top,
        probabilities=dict(found.report.cause.probabilities),
        fraction=None if shrinkage is None else shrinkage["fraction"],
        atlas=atlas.simulations,
        solved=found.report.cost.simulations,
    )
