"""Which effects were found, with their sizes and what these captures cannot tell from them, for the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from diagnosis.effect import SCALAR, Effect
from diagnosis.effects import get_effect
from diagnosis.groups import NOT_EFFECTS, group_of
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.inference.cause import Cause
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.report import CauseReport, FoundEffect
from diagnosis.separation import not_separable

CLOSE = 2.0
"""An effect whose log evidence comes this near to the named one's is not told apart from it."""


def cause_report(cause: Cause, blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> CauseReport:
    """The report's ``cause``.

    Args:
        cause: found.
        blocks, pixels, model: what was measured, and how likely it is.
    """
    unlike = {*cause.named, *NOT_EFFECTS}
    alike: dict[str, tuple[str, ...]] = {}
    for name in cause.named:
        near = group_of(name) | (as_likely(cause, name) - cause.refuted_before)
        if not get_effect(name).random_repeats:
            near |= set(not_separable(name, cause.size(name), blocks, pixels, model))
        alike[name] = tuple(sorted((near - unlike) & set(cause.probabilities)))
    of_two: dict[str, Any] = {"both_probability": cause.both_probability, "alike": alike}
    return CauseReport(
        probabilities=dict(cause.probabilities),
        top=cause.top,
        effects=tuple(_found(cause, name) for name in cause.named),
        not_separable_from=tuple(sorted({other for near in alike.values() for other in near})),
        **(of_two if len(cause.named) == 2 else {}),
    )


def as_likely(cause: Cause, name: str) -> set[str]:
    """What might stand in place of a named effect; of two named, beside the other one."""
    if len(cause.named) < 2 or cause.pair is None:
        least = cause.evidence[name].log_evidence - CLOSE
        return {other for other, evidence in cause.evidence.items() if evidence.log_evidence > least}
    beside = next(other for other in cause.named if other != name)
    both = {cause.pair.first, cause.pair.second}  # as weighed: those that were tried are, too
    own = next((pair for pair in cause.tried if {pair.first, pair.second} == both), cause.pair)
    least = own.evidence.log_evidence - CLOSE
    near = [pair for pair in cause.tried if pair.evidence.log_evidence > least]
    return {other for pair in near for other in (pair.first, pair.second) if beside in (pair.first, pair.second)}


def _found(cause: Cause, name: str) -> FoundEffect:
    effect = get_effect(name)
    size, interval = dict(cause.size(name)), dict(cause.evidence[name].interval_90)
    if len(cause.named) == 2 and cause.pair is not None:
        # the pair moves the sizes: intervals move along
        if name == cause.pair.second:
            interval = dict(cause.pair.evidence.interval_90)
        else:
            interval = moved_along(interval, cause.evidence[name].size, size)
    interval = as_can_be(interval, effect)
    scalar = SCALAR in size
    return FoundEffect(
        name=name,
        stage=effect.stage.value,
        magnitude=size[SCALAR] if scalar else size,
        unit=effect.unit,
        interval_90=interval[SCALAR] if scalar else interval,
        place={} if effect.random_repeats or not scalar else {k: v for k, v in size.items() if k != SCALAR},
    )


def moved_along(
    interval: Mapping[str, tuple[float, float]],
    alone: Mapping[str, float],
    size: Mapping[str, float],
) -> dict[str, tuple[float, float]]:
    """An interval of a size that turned out to be another: as wide as before, of one number of the same sign in
    proportion.
    """
    if list(interval) == [SCALAR] and alone[SCALAR] * size[SCALAR] > 0.0:
        low, high = interval[SCALAR]
        return {SCALAR: (low * size[SCALAR] / alone[SCALAR], high * size[SCALAR] / alone[SCALAR])}
    return {k: (a + size[k] - alone[k], b + size[k] - alone[k]) for k, (a, b) in interval.items()}


def as_can_be(interval: Mapping[str, tuple[float, float]], effect: Effect) -> dict[str, tuple[float, float]]:
    """An interval without sizes that are larger than there can be (:attr:`diagnosis.effect.Component.most`)."""
    most = {key: effect.components[key].most for key in interval}
    return {key: (max(low, -most[key]), min(high, most[key])) for key, (low, high) in interval.items()}
