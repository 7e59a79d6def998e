"""What a second effect on the cloth changes where the likeliest one is on already: measured from its fold states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from diagnosis.afresh.each_capture import each_capture
from diagnosis.afresh.fresh import FreshLook, Sized, changes_pictures, is_mechanical
from diagnosis.afresh.refinement import alike, leader
from diagnosis.afresh.side_by_side import side_by_side
from diagnosis.effects import get_effect
from diagnosis.groups import group_of
from diagnosis.inference.cause import Cause
from diagnosis.simulation.responses import responses_with
from diagnosis.tasks.fabric_task import CaptureResult
from diagnosis.workers import ALONE, Workers


def look_beside(
    looks: Mapping[str, FreshLook], cause: Cause, scene: str, workers: Workers = ALONE
) -> dict[str, FreshLook]:
    """Responses of every second effect from the states that the leading one gives at its fitted size.

    From the state without it, where folds stand elsewhere, a second effect may seem to do the opposite.

    Args:
        looks: by fabric.
        cause: how likely explanations are.
        scene: whose captures are looked at.
        workers: that simulate fabrics side by side.

    Returns:
        The same fabrics; as they were where no effect on the cloth leads, or one on camera or sensor is named with it.
    """
    first = leader(cause)
    others = any(changes_pictures(name) for name in cause.named)
    if first is None or not is_mechanical(get_effect(first)) or others:
        return dict(looks)
    measured = partial(_measured, first=(first, cause.evidence[first].size))
    work = partial(each_capture, change=measured, scene=scene)
    return dict(zip(looks, side_by_side(work, list(looks.values()), workers), strict=True))


def _measured(look: FreshLook, capture: CaptureResult, first: Sized) -> CaptureResult:
    """With the responses of all others beside an effect of some size; as it was where that does not come to rest."""
    name, size = first
    seen = [old for old in look.sizes.get(name, []) if alike(size, old, get_effect(name))]
    on = (name, seen[-1] if seen else size)
    state = look.drape(capture, [on])
    if not state.drape.ok:
        return capture
    known = capture.responses.effects
    able = [other for other in known if is_mechanical(get_effect(other))]
    seconds = {other: known[other] for other in able if other not in group_of(name)}
    found = responses_with(look.simulator, look.result.task.parameters, look.seen(capture, [on]), state, seconds)
    look.beside[capture.id] = {(second, name): rows for second, rows in found.items()}
    beside = {**capture.responses.beside, **look.beside[capture.id]}
    return replace(capture, responses=replace(capture.responses, beside=beside))
