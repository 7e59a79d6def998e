"""90 % intervals of fitted sizes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

Array = NDArray[np.float64]


def all_inside(count: int) -> float:
    """Half width, in standard deviations, of intervals that hold all of so many independent numbers with 90 %."""
    return float(norm.ppf(0.5 + 0.5 * 0.9 ** (1.0 / count)))


def size_interval(sizes: Array, mass: Array, top: float, share: float = 0.0) -> tuple[float, float]:
    """5 and 95 % points of a distribution on a grid (in any order, with repeats), widened to hold ``top`` and by an
    error of the size's logarithm (on a side that reaches zero there is nothing to widen).

    Each point's mass lies half to either side of it: all of it below would shift an interval by half a step.
    """
    points, where = np.unique(sizes, return_inverse=True)
    own = np.bincount(where, weights=mass)
    middle = np.cumsum(own) - 0.5 * own
    low, high = (float(np.interp(q, middle, points)) for q in (0.05, 0.95))
    return _further(min(low, top), top, share, upper=False), _further(max(high, top), top, share, upper=True)


def _further(end: float, top: float, share: float, *, upper: bool) -> float:
    """An end of an interval, further from ``top`` by a relative error."""
    if end * top <= 0.0:
        return end
    reach = float(np.hypot(np.log(end / top), 1.645 * share))
    return top * float(np.exp(reach if upper == (top > 0) else -reach))
