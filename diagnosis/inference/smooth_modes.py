"""Smooth changes of the cloth of any form, for what no effect describes."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from diagnosis.measurement.reference import CELLS, cell_centres

UNKNOWN_LENGTH = 0.15
"""Correlation length of such a change, in sample sizes."""
UNKNOWN_FORMS = 40


@cache
def smooth_modes() -> NDArray[np.float64]:
    """Random smooth changes of the cloth of root mean square one: their principal forms, [cells + ring, forms]."""
    centre = cell_centres()
    cloth = np.arange(len(centre)) < CELLS * CELLS
    distance = np.linalg.norm(centre[:, None] - centre[None], axis=2)
    kernel = np.exp(-0.5 * (distance / UNKNOWN_LENGTH) ** 2) * np.outer(cloth, cloth)
    size, forms = np.linalg.eigh(kernel)
    chosen = np.argsort(-size)[:UNKNOWN_FORMS]
    return np.asarray(forms[:, chosen] * np.sqrt(np.maximum(size[chosen], 0.0)))
