"""What a second effect on the cloth changes where the likeliest one is on already: measured from its fold states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from diagnosis.cause import Cause
from diagnosis.effects import get_effect
from diagnosis.fresh import FreshLook, Sized, is_mechanical
from diagnosis.groups import group_of
from diagnosis.refinement import alike, leader
from diagnosis.responses import responses_with
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
    others = [name for name in cause.named if not is_mechanical(get_effect(name))]
    if first is None or not is_mechanical(get_effect(first)) or others:
        return dict(looks)
    work = partial(_looked_at, first=(first, cause.evidence[first].size), scene=scene)
    return dict(zip(looks, workers.map(work, list(looks.values())), strict=True))


def _looked_at(look: FreshLook, first: Sized, scene: str) -> FreshLook:
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # it ships no type information

    name, size = first
    known = [old for old in look.sizes.get(name, []) if alike(size, old, get_effect(name))]
    on = [(name, known[-1] if known else size)]
    captures = []
    with threadpool_limits(1):
        for capture in look.result.captures:
            state = look.drape(capture, on) if capture.scene == scene else capture.base
            if capture.scene == scene and state.drape.ok:
                seconds = [n for n in capture.responses.effects if is_mechanical(get_effect(n)) and _apart(n, name)]
                fabric = look.result.task.parameters
                found = responses_with(look.simulator, fabric, look.seen(capture, on), state, seconds)
                look.beside[capture.id] = {(second, name): rows for second, rows in found.items()}
                both = {**capture.responses.beside, **look.beside[capture.id]}
                capture = replace(capture, responses=replace(capture.responses, beside=both))
            captures.append(capture)
    return replace(look, result=replace(look.result, captures=tuple(captures)))


def _apart(name: str, other: str) -> bool:
    return name not in group_of(other)
