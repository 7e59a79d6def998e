"""The floor of a gap: by how much repeats of one capture differ from each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.block import Block

Array = NDArray[np.float64]


def repeat_squares(block: Block, values: Array, chosen: NDArray[np.bool_] | None = None) -> float | None:
    """Mean square by which repeats differ from their mean, cell by cell; None where there is one capture.

    Args:
        block: whose captures.
        values: residuals [m], [n].
        chosen: measurements that count, bool [n]; all by default.
    """
    count = len(block.captures)
    if count < 2:
        return None
    table = np.full((count, int(block.cell.max()) + 1), np.nan)
    table[block.owner, block.cell] = values if chosen is None else np.where(chosen, values, np.nan)
    everywhere = np.isfinite(table).all(axis=0)
    if not everywhere.any():
        return None
    return float(np.var(table[:, everywhere], axis=0, ddof=1).mean())
