"""What share of a gap above its floor goes away, with its 90 % interval over the blocks that it was measured on."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

Array = NDArray[np.float64]
Interval = tuple[float, float]
DRAWS = 400


def fraction_of(squares: Array) -> float:
    """Share of the gap above the floor that goes away, by the root mean square over blocks, [blocks, 3 or more].

    Not above 1: what is left may be less than the floor, which then counts as no more. -1 where nothing is above it.
    """
    return _share(*np.sqrt(np.mean(squares, axis=0))[:3])


def fraction_of_means(values: Array) -> float:
    """The same of numbers that are distances as they stand, as LPIPS is, by their means over blocks."""
    return _share(*np.mean(values, axis=0)[:3])


def interval_of(rows: Array, fraction: Callable[[Array], float] = fraction_of) -> Interval:
    """90 % interval of a fraction over blocks, [blocks, 3 or more]: from -1 to 1 where there is one alone.

    A bootstrap's, widened as Student's t is against a normal distribution: it rests on few blocks.
    """
    value, count = fraction(rows), len(rows)
    if count < 2:
        return min(-1.0, value), max(1.0, value)
    rng = np.random.default_rng(0)
    draws = [fraction(rows[rng.integers(0, count, count)]) for _ in range(DRAWS)]
    factor = student.ppf(0.95, count - 1) / norm.ppf(0.95) * np.sqrt(count / (count - 1))
    edges = np.quantile(draws, [0.05, 0.95])
    low, high = (float(np.clip(value + factor * (edge - value), -1.0, 1.0)) for edge in edges)
    return min(low, value), max(high, value)


def share_with_floors(
    rows: Sequence[tuple[float, float, float | None]], fraction: Callable[[Array], float]
) -> tuple[float, Interval] | tuple[None, None]:
    """Fraction and interval of (before, after, floor) by block; none where a block has no repeats to give a floor."""
    known = [row for row in rows if row[2] is not None]
    if not rows or len(known) < len(rows):
        return None, None
    table = np.array(known, dtype=np.float64)
    return fraction(table), interval_of(table, fraction)


def _share(before: float, after: float, floor: float) -> float:
    above = before - min(floor, after)
    if above > 0.0:
        return float((before - after) / above)
    return -1.0 if after > before else 0.0
