"""A second effect on the cloth, sought by simulating it beside the first at several sizes.

Responses say how large it is only where it changes shapes in proportion. Beside a strong effect it may not: what pulls
the cloth to the panel does nothing until a draft lets it come near. How far captures are from the simulations does say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.by_distance import known_squares, most, squares
from diagnosis.afresh.fresh import FreshLook, Sized, is_mechanical
from diagnosis.afresh.once import Name
from diagnosis.afresh.together import look_together, with_pairs
from diagnosis.effect import SCALAR, Effect
from diagnosis.effects import get_effect
from diagnosis.inference.cause import Cause
from diagnosis.inference.larger import MUCH
from diagnosis.inference.pairs import Pair
from diagnosis.workers import ALONE, Workers

Array = NDArray[np.float64]
SECOND_EFFECTS = 2
"""So many of the likeliest second effects are simulated."""
MOST_SIZES = 8
"""At so many sizes at most is each simulated for a capture of each fabric (:func:`over_the_range`, :func:`around`)."""
SECOND_LEAVES = 0.7
"""Of the square of most fabrics' distances, a second effect leaves less than this share, or it is left alone."""


def look_for_second(
    looks: Mapping[str, FreshLook], name: Name, scene: str, workers: Workers = ALONE
) -> dict[str, FreshLook]:
    """The likeliest second effects on the cloth beside the leading one, where that leaves much unexplained.

    What is simulated counts only where it lets one of them be named.

    Args:
        looks: by fabric.
        name: the answer from results, two effects together included.
        scene: whose captures are looked at.
        workers: that simulate fabrics side by side.

    Returns:
        The same fabrics; as they were where all is explained, or no second effect brings most fabrics much nearer.
    """
    cause = name([look.result for look in looks.values()])
    if not _leaves_much_on_the_cloth(cause):
        return dict(looks)
    first = max(cause.named, key=lambda effect: cause.evidence[effect].log_evidence)
    on = (first, cause.evidence[first].size)
    trial = {key: look.copy() for key, look in looks.items()}
    alone = known_squares(trial, [on], scene, workers)
    found = []
    for pair in _likeliest(cause, first):
        second = next(n for n in (pair.first, pair.second) if n != first)
        best = _nearest(trial, on, (second, pair.sizes[second]), alone, scene, workers)
        if best is not None:
            found.append(best)
    if not found:
        return dict(looks)
    trial = with_pairs(trial, [as_pair(cause, sizes) for sizes in found], scene, workers)
    trial = look_together(trial, name, scene, workers)
    named = name([look.result for look in trial.values()]).named
    return trial if {second for _, (second, _) in found} & set(named) else dict(looks)


def _leaves_much_on_the_cloth(cause: Cause) -> bool:
    """Effects on the cloth alone are named, and most fabrics differ by more than simulators do for no reason."""
    cloth = all(is_mechanical(get_effect(name)) for name in cause.named)
    return bool(cause.named) and cloth and cause.left is not None and cause.left > MUCH


def _likeliest(cause: Cause, first: str) -> list[Pair]:
    """Pairs of the leading effect and others on the cloth whose size is one number, the likeliest first."""

    def able(pair: Pair) -> bool:
        both = [get_effect(name) for name in (pair.first, pair.second)]
        return first in (pair.first, pair.second) and all(is_mechanical(e) and not e.vector for e in both)

    return sorted(filter(able, cause.tried), key=lambda pair: -pair.evidence.log_evidence)[:SECOND_EFFECTS]


def _nearest(
    looks: Mapping[str, FreshLook], first: Sized, second: Sized, alone: Array, scene: str, workers: Workers
) -> tuple[Sized, Sized] | None:
    """Both with the second at the size that brings most fabrics nearest; None where none brings them much nearer.

    Three sizes over its range, of either sign where it has two, then two more around the best.
    """
    name, fitted = second
    effect = get_effect(name)
    place = {key: value for key, value in fitted.items() if key not in effect.components}

    def left_at(values: Sequence[float]) -> dict[float, float]:
        trials = [(first, (name, {SCALAR: value} | place)) for value in values]
        return {v: most(own, alone) for v, own in zip(values, squares(looks, trials, scene, workers), strict=True)}

    left = left_at(over_the_range(effect))
    best = min(left, key=lambda value: left[value])
    if left[best] >= 1.0:
        return None
    left |= left_at(around(effect, best))
    best = min(left, key=lambda value: left[value])
    return (first, (name, {SCALAR: best} | place)) if left[best] < SECOND_LEAVES else None


def over_the_range(effect: Effect) -> list[float]:
    """The least, the middle and the largest size, of both signs where it has two."""
    own = next(iter(effect.components.values()))
    sizes = [float(size) for size in np.geomspace(own.low, own.high, 3)]
    return sizes + [-size for size in sizes] if own.signed else sizes


def around(effect: Effect, size: float) -> list[float]:
    """Half a step of :func:`over_the_range` less and more."""
    own = next(iter(effect.components.values()))
    step = (own.high / own.low) ** 0.25
    return [size / step, math.copysign(min(abs(size) * step, own.most), size)]


def as_pair(cause: Cause, sizes: tuple[Sized, Sized]) -> Pair:
    """A tried pair with other sizes."""
    names = {name for name, _ in sizes}
    known = next(pair for pair in cause.tried if {pair.first, pair.second} == names)
    return Pair(known.first, known.second, dict(sizes), known.evidence)
