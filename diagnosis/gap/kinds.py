"""The spatial kinds of a difference: what of a shape is smooth and what is folds, and which numbers are not shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.block import Block
from diagnosis.measurement.pixel_statistics import PIXEL_NAMES
from diagnosis.measurement.reference import CELLS, PLANE_NAMES
from diagnosis.report import Kind

Array = NDArray[np.float64]
LOW_ORDER = 3
"""Polynomials of the place on the sample up to this degree are low order; a fold is narrower."""
NUMBERS: Mapping[Kind, tuple[str, ...]] = MappingProxyType({"pixels": PIXEL_NAMES, "panel_plane": PLANE_NAMES})
"""Kinds that show in numbers which a set shares, not in the cloth's cells."""


def smooth_forms(place: Array) -> Array:
    """Polynomials of a place (u, v) in units of the sample up to :data:`LOW_ORDER`, [places, forms]."""
    u, v = 2.0 * place.T - 1.0
    powers = [(i, total - i) for total in range(LOW_ORDER + 1) for i in range(total + 1)]
    return np.stack([u**i * v**j for i, j in powers], axis=1)


def kind_directions(block: Block, centre: Array) -> dict[Kind, Array]:
    """``low_order`` and ``folds`` of the cloth's cells, capture by capture, as orthonormal rows, [of the kind, n].

    The two together span all cells of the cloth that were seen: a difference's squares in both sum to its own.

    Args:
        block: ``n`` measurements.
        centre: of the cells, in units of the sample, [cells + ring, 2].
    """
    low, folds = [], []
    for number in range(len(block.captures)):
        own = np.flatnonzero((block.owner == number) & (block.cell < CELLS * CELLS))
        basis, sizes, _ = np.linalg.svd(smooth_forms(centre[block.cell[own]]), full_matrices=True)
        rank = int(np.count_nonzero(sizes > 1e-9 * sizes.max(initial=0.0)))
        rows = np.zeros((len(own), len(block.cell)))
        rows[:, own] = basis.T
        low.append(rows[:rank])
        folds.append(rows[rank:])
    return {"low_order": np.concatenate(low), "folds": np.concatenate(folds)}


def numbers_of(kind: Kind, names: Sequence[str]) -> NDArray[np.intp]:
    """Which of a set's shared numbers are of a kind."""
    return np.flatnonzero(np.isin(np.asarray(names, dtype=str), NUMBERS[kind]))
