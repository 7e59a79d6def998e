"""Pins moved, weights and bends put on the cloth on trial, from the fold state that each capture shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from diagnosis.afresh.each_capture import each_capture
from diagnosis.afresh.fresh import FreshLook, changes_pictures
from diagnosis.afresh.further import leaves_much, look_further
from diagnosis.afresh.once import Name
from diagnosis.afresh.refinement import Weigh
from diagnosis.afresh.side_by_side import side_by_side
from diagnosis.inference.cause import Cause
from diagnosis.simulation.responses import probe_responses
from diagnosis.tasks.fabric_task import CaptureResult
from diagnosis.workers import ALONE, Workers

SURE = 0.99
"""One or two effects named with more, or something unknown, are not doubted for what probes may say."""


def look_probed(
    looks: Mapping[str, FreshLook], weigh: Weigh, name: Name, scene: str, workers: Workers = ALONE
) -> dict[str, FreshLook]:
    """Responses to :mod:`diagnosis.simulation.probes`, where something outside the catalogue may yet be found.

    Where they make the answer something unknown that was not, the catalogue is simulated on trial first.

    Args:
        looks: by fabric, when all else has been looked at.
        weigh: see :data:`diagnosis.afresh.refinement.Weigh`.
        name: the answer from results, two effects together included.
        scene: whose captures are looked at.
        workers: that simulate fabrics side by side.

    Returns:
        The same fabrics; as they were where the answer is sure, or lies in camera or sensor.
    """
    before = name([look.result for look in looks.values()])
    if not is_open(before):
        return dict(looks)
    probe = partial(each_capture, change=_probed, scene=scene)
    probed = dict(zip(looks, side_by_side(probe, list(looks.values()), workers), strict=True))
    if leaves_much(before) or not leaves_much(name([look.result for look in probed.values()])):
        return probed
    tried = look_further(probed, weigh, name, scene, workers)
    # folds that the trial found have no probes yet
    return dict(zip(tried, side_by_side(probe, list(tried.values()), workers), strict=True))


def is_open(cause: Cause) -> bool:
    """Nothing is named, or what is answered is not sure and not in camera or sensor alone."""
    if cause.top == "none":
        return True
    on_pictures = bool(cause.named) and all(changes_pictures(name) for name in cause.named)
    return not on_pictures and sum(cause.probabilities[name] for name in cause.named or (cause.top,)) <= SURE


def _probed(look: FreshLook, capture: CaptureResult) -> CaptureResult:
    fabric, scene = look.result.task.parameters, look.scene_of(capture)
    rows = probe_responses(look.simulator, fabric, scene, capture.base)
    return replace(capture, responses=replace(capture.responses, probes=rows))
