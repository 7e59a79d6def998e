"""Places between those that are simulated beforehand: whether the leading effect sits at one, told by distance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from diagnosis.afresh.by_distance import most, squares
from diagnosis.afresh.fresh import FreshLook, Sized, is_mechanical
from diagnosis.afresh.once import Name
from diagnosis.afresh.refinement import CLOTH_EFFECTS, LATER_CLOTH_EFFECTS, LOOK_ROUNDS, Search, Weigh, leader
from diagnosis.effect import Effect
from diagnosis.effects import get_effect
from diagnosis.workers import ALONE, Workers

BESIDE_LEAVES = 0.9
"""Share of most fabrics' square distances that a place beside the fitted one must leave less than."""
LOOKS = 1 + LOOK_ROUNDS * (CLOTH_EFFECTS + LATER_CLOTH_EFFECTS)
"""Simulations of effects for a capture, at most: at another place, and in rounds after that."""


def look_between(
    looks: Mapping[str, FreshLook], weigh: Weigh, name: Name, scene: str, workers: Workers = ALONE
) -> dict[str, FreshLook]:
    """The leading effect at further places: beside the one that fits best, or at another width where all do alike.

    What it does between two places is only about a mixture of what it does at them, so its own place is seldom the one
    that fits best before it is simulated there. Where all places do much the same, as wide strips that curl little and
    narrow ones that curl much, the first one to be simulated would fit best whatever is true.

    Args:
        looks: by fabric.
        weigh: single effects alone.
        name: the answer from results, two effects together included.
        scene: whose captures are looked at again.
        workers: that simulate fabrics side by side.

    Returns:
        The same fabrics; as they were where no such effect leads, no place beside brings most fabrics nearer, or the
        effect is not named then.
    """
    cause = name([look.result for look in looks.values()])
    first = leader(cause)
    if first is None or not get_effect(first).between or not is_mechanical(get_effect(first)):
        return dict(looks)
    effect, known = get_effect(first), cause.evidence[first]
    search = Search.after(looks, weigh, scene, workers)
    wanted = search.unseen([(first, known.at_places[number]) for number in further_places(effect, known.size)])
    if wanted and effect.alike == 0.0:
        wanted = _nearer(looks, (first, known.size), wanted, scene, workers)
    if not wanted:
        return dict(looks)
    trial = search.rounds(search.simulated({key: look.copy() for key, look in looks.items()}, wanted))
    return trial if first in name([look.result for look in trial.values()]).named else dict(looks)


def most_looks(effects: Sequence[str]) -> int:
    """Simulations for a capture, at most, where these effects are tried."""
    return LOOKS if any(get_effect(name).between for name in effects) else 0


def most_trials(effects: Sequence[str]) -> int:
    """Simulations for each fabric's first capture, at most: at the fitted place and at those beside it."""
    able = [e for e in map(get_effect, effects) if e.between and e.alike == 0.0]
    beside = [len(further_places(effect, place)) for effect in able for place in effect.tried]
    return 1 + max(beside) if beside else 0


def _nearer(
    looks: Mapping[str, FreshLook], fitted: Sized, others: Sequence[Sized], scene: str, workers: Workers
) -> list[Sized]:
    """Of the others the one that brings most fabrics nearest, all of them simply coming on; none where none does."""
    own, *rest = squares(looks, [[fitted], *([other] for other in others)], scene, workers)
    left = [most(found, own) for found in rest]
    nearest = int(np.argmin(left))
    return [others[nearest]] if left[nearest] < BESIDE_LEAVES else []


def further_places(effect: Effect, size: Mapping[str, float]) -> list[int]:
    """Numbers of the tried places to look at beside a size's own: those of which it is mixed or that are mixed of it;
    where all places do much alike, the one in their middle.
    """
    number, count = effect.number_of(size), len(effect.places)
    if effect.alike > 0.0:
        return [count + len(effect.between) // 2]
    if number >= count:
        return list(effect.between[number - count].shares)
    return [count + n for n, own in enumerate(effect.between) if number in own.shares]
