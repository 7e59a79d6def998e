"""Test rigs: cloths that the public set-ups cannot hold, on one level of the solver."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore import lang
from simcore.grid import Grid
from simcore.mechanics import Mechanics
from simcore.parameters import FabricParameters
from simcore.scenes import GRAVITY_M_S2

from .reference import Cloth, Friction

lang.start()

from simcore.bending_forms import BendingForms  # noqa: E402  (kernels need the runtime)
from simcore.cloths import Cloths  # noqa: E402
from simcore.contact import PanelContact  # noqa: E402
from simcore.level import Level  # noqa: E402
from simcore.newton import Newton, NewtonOptions, Rest  # noqa: E402

Array = NDArray[Any]

FABRICS = {
    "vstiff": FabricParameters(3000, 3000, 3000, 1e-3, 1e-3, 1e-3, 0.2),
    "stiff": FabricParameters(3000, 2500, 1000, 2.5e-4, 2.5e-4, 2.5e-4, 0.4),
    "medium": FabricParameters(1000, 800, 300, 1.5e-5, 1.5e-5, 1.5e-5, 0.2),
    "soft": FabricParameters(300, 200, 100, 1e-6, 1e-6, 1e-6, 0.1),
}
"""The benchmark fabrics of ``docs/benchmarks.md``."""

ANISOTROPIC = FabricParameters(900, 400, 150, 6e-5, 2e-5, 2.5e-5, 0.18)
"""Three times as rigid along warp as along weft."""


@dataclass(frozen=True)
class Rig:
    """A level set up for a cloth, and the same cloth for the NumPy reference."""

    level: Level
    cloth: Cloth

    @classmethod
    def of(
        cls,
        level: Level,
        fabric: FabricParameters,
        held: Array,
        mechanics: Mechanics = Mechanics(),
        panel: bool = False,
        friction: Friction | None = None,
    ) -> Rig:
        """Set the level up; ``held`` bool [rows, columns]."""
        grid = level.grid
        contact = PanelContact.of(
            grid.areas, fabric.density * GRAVITY_M_S2, panel, mechanics.adhesion_pa, mechanics.adhesion_range_m
        )
        if friction is not None:
            contact = PanelContact(
                contact.areas, contact.barrier, panel, contact.adhesion_pa, contact.adhesion_range_m,
                friction.bound, friction.anchor,
            )  # fmt: skip
        level.set_up(fabric, mechanics, contact, held.astype(np.int32))
        return cls(level, Cloth(fabric, grid.hu, grid.hv, held.astype(bool), mechanics, panel, friction))

    def settle(self, x: Array, tolerance: float = 1e-4, iterations: int = 400) -> Array:
        """Minimise from ``x``; asserts that it came to rest."""
        options = NewtonOptions(tolerance=tolerance, certify=False, iterations=iterations)
        rest: Rest = Newton(self.level, options).minimise(x)
        assert rest.converged, f"not at rest: residual {rest.residual}"
        return rest.x

    def hessian(self, x: Array, blend: float = 1.0) -> Array:
        """The assembled Hessian, dense, float64 [3 n, 3 n]; rows and columns of held vertices taken out."""
        dense = assembled(self.level, x, blend)
        free = np.repeat(~self.cloth.held.ravel(), 3)
        return dense[np.ix_(free, free)]


def fields_of(grid: Grid, fabric: FabricParameters, held: Array, mechanics: Mechanics = Mechanics()) -> Cloths:
    """What the kernels know of a cloth without a panel; ``held`` bool [rows, columns]."""
    contact = PanelContact.of(grid.areas, fabric.density * GRAVITY_M_S2, False, 0.0, mechanics.adhesion_range_m)
    return Cloths.one(grid, BendingForms.of(grid), fabric, mechanics, contact, held.astype(np.int32))


def assembled(level: Level, x: Array, blend: float) -> Array:
    """What the level hands to the factorisation, dense and symmetric [3 n, 3 n]."""
    import scipy.sparse as sp

    level.factor(x, blend)
    pattern = level.pattern
    upper = sp.csr_array((level.exact._values, pattern.indices, pattern.indptr), shape=(x.size, x.size)).toarray()
    return upper + np.triu(upper, 1).T


def strip(length_m: float, width_m: float, cell_m: float) -> Level:
    """A level of a strip that is ``length_m`` along u (weft) and ``width_m`` along v (warp)."""
    return Level(Grid(round(width_m / cell_m) + 1, round(length_m / cell_m) + 1, cell_m, cell_m))


def laid_out(grid: Grid, along: Array, across: Array) -> Array:
    """The flat sheet with u along the unit vector ``along`` and v along ``across`` [rows, columns, 3]."""
    u, v = np.arange(grid.columns) * grid.hu, np.arange(grid.rows) * grid.hv
    return u[None, :, None] * np.asarray(along, float) + v[:, None, None] * np.asarray(across, float)


def cylinder(grid: Grid, radius_m: float, heading_rad: float) -> Array:
    """The sheet rolled up without stretch, its curvature running at ``heading_rad`` from weft towards warp."""
    u, v = np.meshgrid(np.arange(grid.columns) * grid.hu, np.arange(grid.rows) * grid.hv)
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    round_, along = u * c + v * s, -u * s + v * c
    return np.stack([radius_m * np.sin(round_ / radius_m), along, radius_m * (1 - np.cos(round_ / radius_m))], axis=2)


def crumpled(grid: Grid, seed: int, amplitude: float = 0.3) -> Array:
    """A rough random state near the flat sheet, in front of the panel; moves of ``amplitude`` cells."""
    rng = np.random.default_rng(seed)
    x = grid.rest + amplitude * grid.hu * rng.standard_normal(grid.shape)
    x[..., 2] = 2e-4 + np.abs(x[..., 2])
    return x


def stated_rigidity(fabric: FabricParameters, angle_from_warp: float) -> float:
    """B(t) of ``docs/conventions.md`` [N·m]."""
    c2, s2 = math.cos(angle_from_warp) ** 2, math.sin(angle_from_warp) ** 2
    mixed = 4 * fabric.bending_bias - fabric.bending_warp - fabric.bending_weft
    return fabric.bending_warp * c2**2 + fabric.bending_weft * s2**2 + mixed * c2 * s2
