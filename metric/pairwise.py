"""Image distances that have to be computed pair by pair."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Feature = TypeVar("Feature")


def pairwise_table(
    a: Sequence[Feature], b: Sequence[Feature], distance: Callable[[Feature, Feature], float]
) -> NDArray[np.float64]:
    """A symmetric distance of every pair, float64, shape [len(a), len(b)]; within one set each pair is computed once.

    Args:
        a, b: features; the same object twice for the pairs within a set.
        distance: of two features, the same either way round.
    """
    if a is not b:
        return np.array([[distance(x, y) for y in b] for x in a])
    table = np.empty((len(a), len(a)))
    for row, first in enumerate(a):
        for column in range(row, len(a)):
            table[row, column] = table[column, row] = distance(first, a[column])
    return table
