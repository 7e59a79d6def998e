"""Two effects simulated together: what one changes where another one is there, too, is not what it changes alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.each_capture import each_capture
from diagnosis.afresh.fresh import FreshLook, Sized, is_mechanical, with_effects
from diagnosis.afresh.once import Name
from diagnosis.afresh.outcomes import bend, bent, in_nearest_folds
from diagnosis.afresh.refinement import alike
from diagnosis.afresh.side_by_side import side_by_side
from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.groups import NOT_EFFECTS
from diagnosis.inference.cause import Cause
from diagnosis.inference.pairs import Pair
from diagnosis.inference.subtract import response_to
from diagnosis.simulation.sizes import nodes
from diagnosis.simulation.variations import clean, sensed
from diagnosis.tasks.fabric_task import CaptureResult
from diagnosis.workers import ALONE, Workers

Array = NDArray[np.float64]
PAIR_ROUNDS = 3
ROUND_PAIRS = 2
"""So many pairs are solved in a round, and so many rendered."""
SOLVED_NATS, LATER_NATS, RENDERED_NATS = 6.0, 2.0, 12.0
"""A pair whose log evidence is further behind is not solved, not solved after the first round, or not rendered."""


def look_together(
    looks: Mapping[str, FreshLook], name: Name, scene: str, workers: Workers = ALONE
) -> dict[str, FreshLook]:
    """The likeliest pairs simulated with both effects on, at the sizes that fit best.

    Args:
        looks: by fabric.
        name: the answer from results, two effects together included.
        scene: whose captures are looked at again.
        workers: that simulate fabrics side by side.

    Returns:
        The same fabrics, with the response of the second effect beside the first where it was simulated.
    """
    seen: dict[tuple[str, str], list[Pair]] = {}
    now = dict(looks)
    for _ in range(PAIR_ROUNDS):
        nats = LATER_NATS if seen else SOLVED_NATS
        likely = candidates(name([look.result for look in now.values()]), nats)
        wanted = [
            pair for pair in likely if not any(_same(pair, old) for old in seen.get((pair.first, pair.second), []))
        ]
        if not wanted:
            break
        for pair in wanted:
            seen.setdefault((pair.first, pair.second), []).append(pair)
        now = with_pairs(now, wanted, scene, workers)
    return now


def with_pairs(
    looks: Mapping[str, FreshLook], pairs: Sequence[Pair], scene: str, workers: Workers = ALONE
) -> dict[str, FreshLook]:
    """Fabrics with what pairs of effects do together, at the sizes they have, in all captures of a scene."""
    work = partial(each_capture, change=partial(with_both, pairs=pairs), scene=scene)
    return dict(zip(looks, side_by_side(work, list(looks.values()), workers), strict=True))


def candidates(cause: Cause, nats: float = SOLVED_NATS) -> list[Pair]:
    """Pairs that may be the answer and are more than the sum of their parts; few of those that must be solved.

    They are better than none. What must be solved is less than some nats behind the best explanation, by one effect or
    two; what is only rendered may be further behind the best effect: statistics of pixels are far from additive.
    """
    single = max(e.log_evidence for name, e in cause.evidence.items() if name not in NOT_EFFECTS)
    none = cause.evidence["none"].log_evidence
    tried = sorted(cause.tried, key=lambda pair: -pair.evidence.log_evidence)
    best = max([single, *(pair.evidence.log_evidence for pair in tried[:1])])

    def beyond(least: float) -> list[Pair]:
        return [pair for pair in tried if pair.evidence.log_evidence > max(least, none)]

    solved = [pair for pair in beyond(best - nats) if _move_the_cloth(pair)]
    rendered = [pair for pair in beyond(single - RENDERED_NATS) if _on_one_sensor(pair)]
    return solved[:ROUND_PAIRS] + rendered[:ROUND_PAIRS]


def _move_the_cloth(pair: Pair) -> bool:
    """Both do; beside what only moves the picture, a second effect would be sought in folds that the first was not."""
    return all(is_mechanical(get_effect(name)) for name in (pair.first, pair.second))


def _on_one_sensor(pair: Pair) -> bool:
    return all(get_effect(name).stage is Stage.SENSOR for name in (pair.first, pair.second))


def _same(pair: Pair, other: Pair) -> bool:
    return all(alike(pair.sizes[name], other.sizes[name], get_effect(name)) for name in (pair.first, pair.second))


def with_both(look: FreshLook, capture: CaptureResult, pairs: Sequence[Pair]) -> CaptureResult:
    """With the second effects' responses such that both together give what was simulated so far.

    Where the first effect alone, once the second is gone again, fits better than it was known to, it gets that too.
    """
    for pair in pairs:
        if not _on_one_sensor(pair) and look.without_last(capture, _both(pair)):
            look.sizes.setdefault(pair.first, []).append(pair.sizes[pair.first])
            capture = in_nearest_folds(look, capture, [(pair.first, pair.sizes[pair.first])])
            names = [name for name in look.sizes if name in capture.responses.effects]
            capture = replace(capture, responses=bent(look, capture, names))
    beside = dict(capture.responses.beside)
    for pair in pairs:
        found = _sensed_with_both(look, capture, pair) if _on_one_sensor(pair) else _simulated(look, capture, pair)
        if found is not None:
            beside[pair.second, pair.first] = found
    return replace(capture, responses=replace(capture.responses, beside=beside))


def _simulated(look: FreshLook, capture: CaptureResult, pair: Pair) -> tuple[Array, Array] | None:
    """The second effect's responses (vectors, pixels), bent through the outcomes of both; None where there are none."""
    effects, outcomes = capture.responses.effects, look.together.setdefault((pair.second, pair.first), [])
    if _both(pair) not in outcomes:
        outcomes.append(_both(pair))
    own, pixels = look.beside.get(capture.id, {}).get((pair.second, pair.first), effects[pair.second])
    first = {pair.first: effects[pair.first][0]}
    known = [
        (second, look.change(capture, [one, (name, second)]) - response_to(first, *one))
        for one, (name, second) in outcomes
        if look.drape(capture, [one, (name, second)]).drape.ok
    ]
    return (bend(get_effect(pair.second), own, known), pixels) if known else None


def _sensed_with_both(look: FreshLook, capture: CaptureResult, pair: Pair) -> tuple[Array, Array]:
    """The same of two effects on one sensor, at all sizes of the second: nothing must be solved."""
    scene, second, effects = look.scene_of(capture), get_effect(pair.second), capture.responses.effects
    first = {pair.first: pair.sizes[pair.first]}

    def seen(*sizes: Sized) -> tuple[Array, Array]:
        features = sensed(capture.reference.depth, with_effects(scene, sizes), capture.reference)
        return features.vector(), features.pixels

    still = seen()
    taken = [response_to({pair.first: rows}, pair.first, first[pair.first]) for rows in effects[pair.first]]
    rows = []
    for size in nodes(second):
        both = seen(*first.items(), (pair.second, size))
        rows.append([clean(shown - before - own) for shown, before, own in zip(both, still, taken, strict=True)])
    vectors, pixels = (np.stack(values) for values in zip(*rows, strict=True))
    if second.white or get_effect(pair.first).white:
        # cells move as without what changes pixels by chance: one draw of it would stand against every capture
        vectors = effects[pair.second][0]
    return vectors, pixels


def _both(pair: Pair) -> list[Sized]:
    return [(name, pair.sizes[name]) for name in (pair.first, pair.second)]
