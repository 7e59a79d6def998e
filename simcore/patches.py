"""Newton on the few vertices that are far from rest, while the others are held."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from simcore.level import Level
from simcore.pardiso import Factorisation

Array = NDArray[np.float64]

SHARE = 0.9
"""Share of the squared residual that a patch takes in."""
MARGIN = 4
"""Cells around the unrested vertices that move with them."""
LARGEST = 0.45
"""Share of the vertices beyond which the whole sample is as well solved at once."""


def unrested(level: Level, gradient: Array) -> NDArray[np.bool_] | None:
    """Vertices to free: the fewest that hold most of the residual, with a margin; None when they are too many.

    Args:
        gradient: [N], shape [rows, columns, 3].

    Returns:
        Mask of shape [rows, columns].
    """
    from scipy.ndimage import binary_dilation

    square = np.einsum("jic,jic->ji", gradient, gradient)
    ordered = np.sort(square, axis=None)[::-1]
    running = np.cumsum(ordered)
    least = ordered[np.searchsorted(running, SHARE * running[-1])]
    near = binary_dilation(square >= least, np.ones((3, 3), dtype=bool), MARGIN)
    mask: NDArray[np.bool_] = near & (level.fixed == 0)
    return None if mask.mean() > LARGEST else mask


@contextmanager
def only(level: Level, mask: NDArray[np.bool_]) -> Iterator[None]:
    """Hold all vertices of a level but those of ``mask`` for the length of the block."""
    fixed, exact, rough = level.fixed, level.exact, level.rough
    level.fixed = np.where(mask, 0, 1).astype(np.int32)
    level.exact = level.rough = _Part(level, mask)
    try:
        yield
    finally:
        level.fixed, level.exact, level.rough = fixed, exact, rough


class _Part(Factorisation):
    """Factorisation of the rows and columns of free vertices; takes and gives what the whole would.

    In single precision: a patch only leads on, nothing is certified on it.
    """

    def __init__(self, level: Level, mask: NDArray[np.bool_]) -> None:
        indptr, indices, _ = level.grid.pattern
        free = np.repeat(mask.ravel(), 3)
        rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        kept = free[rows] & free[indices]
        number = np.cumsum(free) - 1
        counts = np.bincount(number[rows[kept]], minlength=int(free.sum()))
        self._kept = np.flatnonzero(kept)
        self._free = np.flatnonzero(free)
        indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        super().__init__(indptr, number[indices[kept]], single=True)

    def factor(self, values: Array) -> int:
        """See :meth:`Factorisation.factor`."""
        return super().factor(values[self._kept])

    def solve(self, right: Array) -> Array:
        """See :meth:`Factorisation.solve`; zero where held."""
        out = np.zeros_like(right)
        out[..., self._free] = super().solve(right[..., self._free])
        return out
