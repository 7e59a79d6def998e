"""The floor of a gap: by how much repeats of one capture differ from each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.block import Block

Array = NDArray[np.float64]


def repeat_squares(block: Block, values: Array, chosen: NDArray[np.bool_] | None = None) -> float | None:
    """Mean square by which repeats differ from their mean, cell by cell; None where no set-up was captured twice.

    Args:
        block: whose captures.
        values: residuals [m], [n].
        chosen: measurements that count, bool [n]; all by default.
    """
    squares, weights = [], []
    for table in block.repeats(values if chosen is None else np.where(chosen, values, np.nan)):
        everywhere = np.isfinite(table).all(axis=0)
        if everywhere.any():
            squares.append(float(np.var(table[:, everywhere], axis=0, ddof=1).mean()))
            weights.append(len(table) - 1)
    return float(np.average(squares, weights=weights)) if squares else None
