"""Image distances that are a squared Euclidean distance between feature vectors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float16] | NDArray[np.float32]


def squared_distance_table(a: Sequence[Vector], b: Sequence[Vector], *, block: int = 1 << 17) -> NDArray[np.float64]:
    """|a_i - b_j|² of every pair, float64, shape [len(a), len(b)].

    One pass of matrix products over blocks of the vectors instead of len(a) x len(b) subtractions. Each block is
    centred on the mean of all vectors first: distances do not change and nothing cancels.

    Args:
        a, b: vectors of one length.
        block: entries taken at a time.
    """
    rows, length = len(a), a[0].shape[0]
    table = np.zeros((rows, len(b)))
    for start in range(0, length, block):
        part = np.stack([v[start : start + block] for v in (*a, *b)]).astype(np.float32)
        part -= part.mean(axis=0)
        first, second = part[:rows], part[rows:]
        norms = np.einsum("ij,ij->i", part, part, dtype=np.float64)
        table += norms[:rows, None] + norms[None, rows:] - 2.0 * (first @ second.T).astype(np.float64)
    clipped: NDArray[np.float64] = np.maximum(table, 0.0)
    return clipped
