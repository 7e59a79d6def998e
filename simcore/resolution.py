"""Whether a mesh is fine enough for the folds that came out on it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simcore.cloths import Cloths
from simcore.grid import OFFSETS, SKEW_OFFSETS
from simcore.membrane_kernels import HU, HV, K_WARP, K_WEFT

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SHARP_RAD = math.radians(45.0)
"""A turn from one cell to the next that the mesh makes a kink of."""
FOLDED_RAD = math.radians(10.0)
"""Cells at whose corners no grid line turns by so much are flat."""
AWAY_M = 0.05
"""Nearer the magnets the cloth is strained, which the resistance of cells has a part in."""
FINE_CELL_M = 0.0101
PREVIEW_SHARE, FINE_SHARE = 0.25, 0.04
"""Share of kinked vertices beyond which the mesh, not the fabric, shapes the drape.

Meshes coarser than 10 mm are previews, on which every soft fabric has kinks; only a mesh-wide zigzag is told there,
and nowhere one of turns below :data:`SHARP_RAD`.
Of fabrics drawn from the measured prior the worst has 0.039 on 10 mm (of 200), 0.06 on 20 mm and 0.19 on 50 mm (of 20).
"""
LARGEST_RESISTANCE = 0.5
"""Of :func:`mesh_resistance`; beyond it bending hardly matters any more (decision 051)."""


def kinked_share(x: Array) -> float:
    """Share of the vertices at which a grid line turns by more than 45 degrees, of the direction that has more.

    Args:
        x: positions [m], shape [rows, columns, 3].
    """
    turned = [_turns(x, axis, SHARP_RAD) for axis in (0, 1)]
    return max(float(t.mean()) if t.size else 0.0 for t in turned)


def largest_share(cell_m: float) -> float:
    """Share of kinked vertices that a mesh of such cells may have."""
    return FINE_SHARE if cell_m <= FINE_CELL_M else PREVIEW_SHARE


def mesh_resistance(x: Array, cloth: Cloths) -> float:
    """What the mesh resists folds with, in parts of what the fabric does.

    The energy of folded cells' hourglass modes, which only a mesh has, over the energy of bending.

    Finite element codes watch the energy of their hourglass control in the same way (Flanagan and Belytschko 1981).
    Cells near held vertices do not count, and of a flat sheet none.

    Args:
        x: positions [m], shape [rows, columns, 3].
        cloth: its fields, one cloth.
    """
    folded = np.zeros(x.shape[:2], dtype=bool)
    folded[1:-1] |= _turns(x, 0, FOLDED_RAD)
    folded[:, 1:-1] |= _turns(x, 1, FOLDED_RAD).T
    near = _within(cloth.fixed[0] == 1, round(AWAY_M / float(cloth.settings[0, HU])))
    counted = _any_corner(folded) & ~_any_corner(near)
    resisted = float(_hourglass_energies(x, cloth)[counted].sum())
    return resisted / _bending_energy(x, cloth) if resisted > 0.0 else 0.0


def _turns(x: Array, axis: int, least_rad: float) -> Mask:
    """Where a grid line along ``axis`` turns by more than that; shape [vertices inside the line, lines]."""
    edges = np.moveaxis(np.diff(x, axis=axis), axis, 0)
    edges = edges / np.linalg.norm(edges, axis=2, keepdims=True)
    return np.asarray(np.sum(edges[:-1] * edges[1:], axis=2) < math.cos(least_rad))


def _any_corner(vertices: Mask) -> Mask:
    """Cells of which a corner is."""
    return vertices[:-1, :-1] | vertices[:-1, 1:] | vertices[1:, :-1] | vertices[1:, 1:]


def _within(vertices: Mask, steps: int) -> Mask:
    """Vertices within so many steps, along rows and columns, of one that is."""
    sums = np.pad(vertices.astype(np.int64), ((steps + 1, steps), (steps + 1, steps))).cumsum(axis=0).cumsum(axis=1)
    size = 2 * steps + 1
    return np.asarray(sums[size:, size:] - sums[:-size, size:] - sums[size:, :-size] + sums[:-size, :-size] > 0)


def _hourglass_energies(x: Array, cloth: Cloths) -> Array:
    """Of each cell [J], as ``membrane_kernels.cell_energy`` has it."""
    settings = cloth.settings[0]
    hu, hv = float(settings[HU]), float(settings[HV])
    right, below = np.diff(x, axis=1), np.diff(x, axis=0)
    a, b = (right[:-1] + right[1:]) / (2.0 * hu), (below[:, :-1] + below[:, 1:]) / (2.0 * hv)
    twist = right[1:] - right[:-1]
    aq, bq = np.sum(a * twist, axis=2) / hu, np.sum(b * twist, axis=2) / hv
    share = cloth.hourglass[0] / 24.0
    return np.asarray(hu * hv * share * (settings[K_WEFT] * aq * aq + settings[K_WARP] * bq * bq))


def _bending_energy(x: Array, cloth: Cloths) -> float:
    """[J], of the flat sheet's: what the cloth was set to (rest curvature) is not taken off."""
    energy = sum(_form(x, cloth.bending[0, ..., m], *OFFSETS[m]) for m in range(1, len(OFFSETS)))
    if cloth.skew is not None:
        energy += sum(_form(x, cloth.skew[0, ..., m], *offset) for m, offset in enumerate(SKEW_OFFSETS))
    return energy


def _form(x: Array, stiffness: Array, down: int, across: int) -> float:
    """-½ Σ K |x_i - x_j|² over the pairs so many rows and columns apart."""
    rows, columns = x.shape[:2]
    left, right = max(0, -across), columns - max(0, across)
    apart = x[down:, left + across : right + across] - x[: rows - down, left:right]
    return float(-0.5 * np.sum(stiffness[: rows - down, left:right] * np.sum(apart * apart, axis=2)))
