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

SAMPLED_CELL_M = 0.0201
"""Largest cell at whose vertices rest curvatures are taken as they are; the catalogue's are no narrower [m]."""
SUBCELLS = 10
"""Points along each side of a larger cell over which they are averaged."""


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
        """Gravity, hem and a uniform draft, lumped to vertices."""
        mass = fabric.density * grid.areas
        hem = grid.areas[-1] / (0.5 * grid.hv)  # length of the bottom edge that each of its vertices stands for
        mass[-1] += mechanics.hem_kg_m * hem
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
    """A rest curvature at vertices; on coarse cells its mean round each, since what is narrower could fall between."""
    if max(grid.hu, grid.hv) <= SAMPLED_CELL_M:
        return field.evaluate(u, v, size)
    shares = (np.arange(SUBCELLS) + 0.5) / SUBCELLS - 0.5
    parts = [field.evaluate(u + a * grid.hu, v + b * grid.hv, size) for a in shares for b in shares]
    return np.mean([part[0] for part in parts], axis=0), np.mean([part[1] for part in parts], axis=0)
