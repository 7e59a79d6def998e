"""Forces and rest moments that a fabric and its mechanics put on the vertices of a grid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.bending import PlateRigidity
from simcore.grid import Grid
from simcore.mechanics import CurvatureField, Mechanics
from simcore.parameters import FabricParameters

Array = NDArray[np.float64]

PART_M = 2.5e-3
"""Longest part of a cell over which a rest curvature counts as uniform [m]; a cell has two at least."""


@dataclass(frozen=True)
class Load:
    """What a fabric and its mechanics put on a level's vertices.

    Attributes:
        mass: [kg], shape [rows, columns].
        force: constant force [N], shape [rows, columns, 3].
        weight: weight of an interior vertex [N], the unit of residuals.
    """

    mass: Array
    force: Array
    weight: float

    @classmethod
    def of(cls, grid: Grid, fabric: FabricParameters, mechanics: Mechanics) -> Load:
        """Gravity, hem and trims, and a uniform draft, lumped to vertices."""
        mass = fabric.density * grid.areas
        left, right, top, bottom = mechanics.trim_kg_m
        along_u = grid.areas[-1] / (0.5 * grid.hv)  # length of an edge that each of its vertices stands for
        along_v = grid.areas[:, 0] / (0.5 * grid.hu)
        mass[0] += top * along_u
        mass[-1] += (bottom + mechanics.hem_kg_m) * along_u
        mass[:, 0] += left * along_v
        mass[:, -1] += right * along_v
        force = mass[..., None] * np.asarray(mechanics.gravity)
        force[..., 2] += mechanics.air_pressure_pa * grid.areas
        gravity = math.sqrt(sum(g * g for g in mechanics.gravity))
        return cls(mass, force, fabric.density * grid.hu * grid.hv * gravity)


def rest_moments(grid: Grid, plate: PlateRigidity, mechanics: Mechanics) -> Array | None:
    """Area times the moment of the rest curvature over h², along u and v, shape [rows, columns, 2] [N]; None for none.

    A second difference that would leave the grid has none.
    """
    if not mechanics.rest_curvature:
        return None
    v, u = np.meshgrid(np.arange(grid.rows) * grid.hv, np.arange(grid.columns) * grid.hu, indexing="ij")
    size = ((grid.columns - 1) * grid.hu, (grid.rows - 1) * grid.hv)
    fields = [_of_cells(field, grid, u, v, size) for field in mechanics.rest_curvature]
    weft, warp = sum(f[0] for f in fields), sum(f[1] for f in fields)
    # the plate couples its curvatures at inner vertices only: coupled at the border too, a free sheet would not rest
    coupled = np.zeros((grid.rows, grid.columns))
    coupled[1:-1, 1:-1] = plate.coupling * grid.hu * grid.hv
    moments = np.zeros((grid.rows, grid.columns, 2))
    moments[..., 0] = (plate.weft * grid.areas * weft + coupled * warp) / grid.hu**2
    moments[..., 1] = (plate.warp * grid.areas * warp + coupled * weft) / grid.hv**2
    moments[:, [0, -1], 0] = 0.0
    moments[[0, -1], :, 1] = 0.0
    return moments


def _of_cells(field: CurvatureField, grid: Grid, u: Array, v: Array, size: tuple[float, float]) -> tuple[Array, Array]:
    """A rest curvature's moments at vertices: its mean over the cells at either side, weighted by the hat function.

    With these a strip of cells takes at its vertices the shape that the curvature gives it, however narrow that is;
    a uniform curvature stays as it is, and a fold keeps its angle.
    """
    weft, warp = np.zeros(u.shape), np.zeros(u.shape)
    for along, weight in _hat(grid.hu):
        weft += weight * field.evaluate(np.clip(u + along, 0.0, size[0]), v, size)[0]
    for along, weight in _hat(grid.hv):
        warp += weight * field.evaluate(u, np.clip(v + along, 0.0, size[1]), size)[1]
    return weft, warp


def _hat(cell_m: float) -> list[tuple[float, float]]:
    """Midpoints of equal parts of the two cells round a vertex [m] and their weights, which add up to one."""
    parts = max(2, math.ceil(cell_m / PART_M))
    places = (np.arange(2 * parts) + 0.5) / parts - 1.0
    return [(float(a) * cell_m, (1.0 - abs(float(a))) / parts) for a in places]
