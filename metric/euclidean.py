"""Image distances that are a squared Euclidean distance between feature vectors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float16] | NDArray[np.float32]


_BLOCK_NUMBERS = 1 << 18  # 1 MB of float32 stays in the processor's cache


def squared_distance_table(a: Sequence[Vector], b: Sequence[Vector]) -> NDArray[np.float64]:
    """|a_i - b_j|² of every pair, float64, shape [len(a), len(b)].

    One pass of matrix products over blocks of the vectors instead of len(a) x len(b) subtractions. Each block is
    centred on the mean of all vectors first: distances do not change and nothing cancels.

    Args:
        a, b: vectors of one length.
    """
    import torch  # converts float16 many times faster than NumPy does

    vectors = [torch.from_numpy(v) for v in (*a, *b)]
    rows, length = len(a), len(a[0])
    block = max(_BLOCK_NUMBERS // len(vectors), 1)
    part = torch.empty((len(vectors), min(block, length)), dtype=torch.float32)
    table = torch.zeros((rows, len(b)), dtype=torch.float64)
    for start in range(0, length, block):
        used = part[:, : min(block, length - start)]
        for row, vector in zip(used, vectors, strict=True):
            row.copy_(vector[start : start + block])
        used -= used.mean(dim=0)
        norms = torch.linalg.vector_norm(used, dim=1).double() ** 2
        table += norms[:rows, None] + norms[None, rows:] - 2.0 * (used[:rows] @ used[rows:].T).double()
    clipped: NDArray[np.float64] = table.clamp_min_(0.0).numpy()
    return clipped
