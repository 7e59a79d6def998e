"""What a user can do next, from what the report says."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from diagnosis.diagnose import Diagnosis
from diagnosis.effect import Effect
from diagnosis.effects import catalogue, get_effect
from diagnosis.groups import NOT_EFFECTS, group_of
from diagnosis.pages.where_figure import SURE
from diagnosis.remedies import remedy
from diagnosis.report import CauseReport, GapReport, Kind, Region, RegionGap, StageName

WIDE = 2.0
"""A gap of so many noise floors that is still no gap needs a word why."""
SURE_OF_NONE = 0.8
"""From this probability of no effect on, and with several fabrics, nothing needs to be done."""
REGION_CHECKS: Mapping[Region, str] = MappingProxyType(
    {
        "pins": "measure where the magnets sit, and see whether the corners slip or are pulled",
        "top_edge": "measure the distance between the magnets, and see whether the edge between them hangs free",
        "sides": "see whether the edges curl, and whether the sample was cut along the grain",
        "hem": "see whether it curls, is sewn or weighted, touches something, or is moved by a draught",
        "interior": "look for creases (press the sample), and for cloth that clings to the panel",
        "panel": "the cloth's outline is elsewhere: measure the camera's and the magnets' places, and the sample",
    }
)
KIND_CHECKS: Mapping[Kind, str] = MappingProxyType(
    {
        "pixels": "the pixels themselves are otherwise than the stated sensor's: photograph the bare panel, state "
        "noise and depth steps as found there, and switch the driver's smoothing and hole filling off",
        "panel_plane": "the panel is seen at another distance or slope: measure the camera's distance with a rule, and "
        "lay a straight edge on the panel",
        "low_order": "the shape differs smoothly: level the panel, shut out draughts, weigh the fabric, check the "
        "stated pin distance and focal length",
        "folds": "folds differ: press the sample, take it down and hang it again: repeats tell chance from cause",
    }
)
CORRECTED: Mapping[str, str] = MappingProxyType(
    {
        "range_noise": "state it in the capture set (sensor.range_noise_m) together with what is stated there: "
        "variances add",
        "quantisation": "state it in the capture set (sensor.quantisation_m)",
        "depth_bias": "take it off the depths of the pictures, or correct the stated distance of the camera",
        "depth_scale": "take it off the depths of the pictures, or correct the stated distance of the camera",
        "sensor_smoothing": "switch the smoothing of the camera's driver off and capture again",
        "dropout": "see why pixels have no data (dark or shiny cloth, light, the driver's filters) and capture again",
        "edge_flying_pixels": "switch on the driver's filter of mixed pixels, or take them out, and capture again",
        "camera_rotation": "correct the stated pose (camera_from_panel)",
        "camera_translation": "correct the stated pose (camera_from_panel)",
        "focal_scale": "correct the stated focal lengths (camera.fx, camera.fy)",
    }
)
"""What to do about effects on camera and sensor that are sure; capture sets state some of them and not all."""
MODELLED = ("sensor_smoothing", "dropout", "edge_flying_pixels")
"""Of these, those that a sweep may have instead."""
STAGE_CHECKS: Mapping[StageName, str] = MappingProxyType(
    {
        "fabric": "capture the samples once more turned by a quarter: what turns with them belongs to the fabric",
        "setup": "measure magnets and panel, and capture once more with another pin distance",
        "environment": "capture once more in still air with the panel wiped and discharged",
        "camera": "calibrate the camera again, and capture a set of its own from another distance to compare the sizes",
        "sensor": "capture the bare panel at two distances, which tells the sensor from the cloth",
    }
)


def advice(diagnosis: Diagnosis) -> list[str]:
    """What a user can do next, the most useful first; never empty."""
    report = diagnosis.report
    cause = report.cause
    unstretched = [r.task.id for r in diagnosis.results if all(c.scene != "stretch" for c in r.captures)]
    estimated = [r.task.id for r in diagnosis.results if r.task.estimated]
    lines: list[str] = []
    if cause.top == "unknown":
        lines += _of_unknown(report.where, cause)
    elif cause.top == "none":
        lines += _of_none(report, len(diagnosis.results))
    else:
        named = [effect.name for effect in cause.effects] or [cause.top]
        lines += [line for name in named for line in _of_named(get_effect(name))]
        lines += _noise_to_state(diagnosis)
    lines += separating(cause)
    if estimated and cause.top != "none":
        of = "" if len(estimated) == len(diagnosis.results) else f" of {', '.join(estimated)}"
        lines.append(
            f"State the parameters{of} as measured, or as estimated from captures without the effect: estimated from "
            "these, they hold a part of what is missing, and a second effect may stand for that."
        )
    if unstretched:
        some = "" if len(unstretched) == len(diagnosis.results) else f" of {', '.join(unstretched)}"
        lines.append(
            f"Add captures of the stretch scene{some}: it repeats far better than hanging and carries the diagnosis."
        )
    if len(diagnosis.results) == 1:
        lines.append("Add other fabrics: with one, a wrong parameter and a missing effect look alike.")
    return lines


def _of_named(effect: Effect) -> list[str]:
    """How to make sure of an effect, and what to do once it is sure."""
    sure = f"Make sure that it is there ({effect.summary.rstrip('.')}): {STAGE_CHECKS[effect.stage.value]}."
    simulate = f"diagnose with --apply and sweep with the file that it writes ({effect.hook})"
    if effect.moves_cloth or effect.random_repeats:
        return [sure, f"To simulate with it, {simulate}."]
    correct = CORRECTED.get(effect.name, f"correct what is stated of {effect.stage.value} and pose")
    return [sure, f"Once it is sure, {correct}" + (f"; or {simulate}." if effect.name in MODELLED else ".")]


def _noise_to_state(diagnosis: Diagnosis) -> list[str]:
    """What to state of a sensor that was found noisier than stated: its noise and what was found, together."""
    added = [effect.magnitude for effect in diagnosis.report.cause.effects if effect.name == "range_noise"]
    stated = {(c.scene.sensor.range_noise_m, c.scene.sensor.at_m) for r in diagnosis.results for c in r.task.captures}
    if len(added) != 1 or isinstance(added[0], dict) or len(stated) != 1:
        return []
    (noise_m, at_m), more_m = next(iter(stated)), added[0]
    return [
        f"Together that is sensor.range_noise_m {math.hypot(noise_m, more_m):.3g} with sensor.at_m {at_m:.3g}: "
        f"{1e3 * noise_m:.3g} mm at that distance by what is stated, {1e3 * more_m:.3g} mm more as found."
    ]


def separating(cause: CauseReport) -> list[str]:
    """What tells the named effects from those that these captures cannot tell from them; one line a remedy."""
    if cause.top in NOT_EFFECTS:
        return []
    named = [effect.name for effect in cause.effects] or [cause.top]
    alike: dict[tuple[str, str], list[str]] = {}
    for other in cause.not_separable_from:
        own = next((name for name in named if other in (*group_of(name), *cause.alike.get(name, ()))), named[0])
        alike.setdefault((own, remedy(own, other)), []).append(other)
    return [f"To tell {own} from {', '.join(others)}: {what}." for (own, what), others in alike.items()]


def strongest(rows: Sequence[RegionGap]) -> list[RegionGap]:
    """The rows that show where a gap lies: of regions, of kinds and of stages the one farthest above its floor.

    Only rows that show a difference count; those of ``stretch`` where it shows any, because it repeats better.
    """
    sure = [row for row in rows if row.p_adjusted < SURE and row.gap > row.noise_floor]
    sure = [row for row in sure if row.scene == "stretch"] or sure
    found = []
    for by in ("region", "kind", "stage"):
        own = [row for row in sure if row.by == by and not (by == "region" and row.region == "all")]
        if own:
            found.append(max(own, key=lambda row: row.gap / max(row.noise_floor, 1e-9)))
    return found


def _of_unknown(rows: Sequence[RegionGap], cause: CauseReport) -> list[str]:
    lines = []
    shown = strongest(rows)
    for row in shown:
        much = f"{row.gap:.2f} {row.unit} against a floor of {row.noise_floor:.2f}, {row.scene}"
        if row.by == "region":
            lines.append(f"The gap stands out most at {row.region} ({much}): {REGION_CHECKS[row.region]}.")
        elif row.by == "kind":
            lines.append(f"Its kind is {row.kind} ({much}): {KIND_CHECKS[row.kind]}.")
        else:
            lines.append(
                f"What effects of the {row.stage} stage do comes nearest to it ({row.effect}, {much}): "
                f"{STAGE_CHECKS[row.stage]}."
            )
    if not shown:
        lines.append("No region, kind or stage stands out: add a repeat of every sample, taken down and hung again.")
    if not any(row.by == "stage" for row in shown):
        lines.append(
            "Capture the same samples once more turned by a quarter: what turns with them belongs to the fabric, what "
            "stays to magnets, panel, room or camera."
        )
    return lines + _not_tried(cause)


def not_tried(cause: CauseReport) -> list[str]:
    """Effects of the catalogue that were left out."""
    return sorted(set(catalogue()) - set(cause.probabilities))


def is_wide(report: GapReport) -> bool:
    """Captures and simulations lie far apart, whether or not that counts as a gap."""
    return report.gap.value > WIDE * report.gap.noise_floor


def _not_tried(cause: CauseReport) -> list[str]:
    left_out = not_tried(cause)
    return [f"Diagnose again with the whole catalogue: {', '.join(left_out)} were not tried."] if left_out else []


def _of_none(report: GapReport, fabrics: int) -> list[str]:
    cause, lines = report.cause, []
    second = max((name for name in cause.probabilities if name != "none"), key=lambda name: cause.probabilities[name])
    if cause.probabilities["none"] < 0.5:
        lines.append(f"Add repeats and fabrics: they decide between no effect at all and {second}, the next likeliest.")
    elif report.gap.detected:
        lines.append(
            "Check what is stated of fabrics and set-up, and add a repeat of every sample, taken down and hung again: "
            "there is a gap, and no effect is probable enough to be named."
        )
    elif cause.probabilities["none"] < SURE_OF_NONE or fabrics == 1 or is_wide(report) or not_tried(cause):
        lines.append(
            "Add fabrics and repeats before the simulation is relied on: nothing speaks for an effect, but these "
            "captures say little against one."
        )
    else:
        lines.append("Nothing needs to be done: the simulation may be used as it is for such fabrics and scenes.")
    lines += _not_tried(cause)
    for row in strongest(report.where):
        if row.by != "stage":
            part = row.region if row.by == "region" else row.kind
            much = f"{row.gap:.2f} {row.unit} against a floor of {row.noise_floor:.2f}"
            why = "one fabric with wrong parameters, or folds that were not found, do that; look at the pictures"
            if row.by == "kind" and row.kind in ("pixels", "panel_plane"):  # which no fabric and no fold does
                why = KIND_CHECKS[row.kind]
            lines.append(f"Yet {part} differs in {row.scene} ({much}): {why}.")
    lines.append(
        "This report does not say how small an effect such captures would have shown: drapemeter diagnose with "
        "--isolability does, from simulations of the same fabrics and scenes."
    )
    return lines
