"""In which order a grid's equations are eliminated, where a better one than PARDISO's own is at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

KEPT = {False: (51, 61, 101), True: (26, 51, 61, 101)}
"""Vertices along a side of the square grids with a file, by ``skew``."""
_FOLDER = Path(__file__).parent / "data" / "elimination"


def elimination_order(rows: int, columns: int, skew: bool) -> NDArray[np.int32] | None:
    """A grid's equations, three a vertex, in the order of their elimination; int32, shape [3 rows columns].

    By minimum local fill (``scripts/elimination_order.py``). On 5 mm cells a factorisation takes 0.85 of the operations
    that PARDISO's minimum degree takes with the neighbours of ``OFFSETS``, 0.54 with those of ``SKEW_OFFSETS`` besides
    (``skew``). None for a grid that is not among :data:`KEPT`.
    """
    if rows != columns or rows not in KEPT[skew]:
        return None
    file = _FOLDER / f"{rows}x{columns}{'-skew' if skew else ''}.npy"
    vertices: NDArray[np.int32] = np.load(file).astype(np.int32)
    return equations_of(vertices)


def equations_of(vertices: NDArray[np.int32]) -> NDArray[np.int32]:
    """The three equations of each vertex, in the vertices' order; int32, shape [3 vertices]."""
    equations: NDArray[np.int32] = np.repeat(3 * vertices, 3)
    equations[1::3] += 1
    equations[2::3] += 2
    return equations
