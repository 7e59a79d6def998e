"""Weights and bends put on the cloth on trial, from the fold state that each capture shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from diagnosis.afresh.fresh import FreshLook, is_mechanical
from diagnosis.effects import get_effect
from diagnosis.inference.cause import Cause
from diagnosis.simulation.responses import probe_responses
from diagnosis.tasks.fabric_task import CaptureResult
from diagnosis.workers import ALONE, Workers

SURE = 0.99
"""One or two effects named with more, or something unknown, are not doubted for what probes may say."""


def look_probed(
    looks: Mapping[str, FreshLook], cause: Cause, scene: str, workers: Workers = ALONE
) -> dict[str, FreshLook]:
    """Responses to :mod:`diagnosis.simulation.probes`, where something outside the catalogue may yet be found.

    Coarse cells do not tell them well enough, so they are simulated on the diagnosis's own, and only where the answer
    is open.

    Args:
        looks: by fabric.
        cause: how likely explanations are.
        scene: whose captures are looked at.
        workers: that simulate fabrics side by side.

    Returns:
        The same fabrics; as they were where the answer is sure, or lies in camera or sensor.
    """
    on_pictures = bool(cause.named) and not any(is_mechanical(get_effect(name)) for name in cause.named)
    answered = sum(cause.probabilities[name] for name in cause.named or (cause.top,))
    if on_pictures or (cause.top != "none" and answered > SURE):
        return dict(looks)
    return dict(zip(looks, workers.map(partial(_looked_at, scene=scene), list(looks.values())), strict=True))


def _looked_at(look: FreshLook, scene: str) -> FreshLook:
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # it ships no type information

    with threadpool_limits(1):
        captures = [_measured(look, c) if c.scene == scene else c for c in look.result.captures]
    return replace(look, result=replace(look.result, captures=tuple(captures)))


def _measured(look: FreshLook, capture: CaptureResult) -> CaptureResult:
    fabric, scene = look.result.task.parameters, look.scene_of(capture)
    rows = probe_responses(look.simulator, fabric, scene, capture.base)
    return replace(capture, responses=replace(capture.responses, probes=rows))
