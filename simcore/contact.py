"""What the panel does to each vertex on its own: barrier, adhesion, friction. Formulas: ``panel_kernels``."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore import panel_kernels as pk
from simcore.panel_kernels import REACH_M, SLIP_M

__all__ = ["ADHESION_SHAPE", "REACH_M", "SLIP_M", "STIFFNESS_WEIGHTS", "PanelContact"]

Array = NDArray[np.float64]
Mask = NDArray[np.int32]

STIFFNESS_WEIGHTS = 5.0
"""Barrier energy scale: this many vertex weights times the reach."""
ADHESION_SHAPE = 3.0 * math.sqrt(3.0) / 8.0
"""Makes the steepest slope of (1 - t²)² one."""


@dataclass(frozen=True)
class PanelContact:
    """Energy of single vertices by their place over the panel.

    Attributes:
        areas: of the vertices [m²], shape [rows, columns].
        barrier: its energy scale at each vertex [J].
        active: whether there is a panel.
        adhesion_pa, adhesion_range_m: largest pull and the distance at which it is gone; 0 for none.
        friction_force: coefficient times normal force [N], shape [rows, columns]; None for none.
        anchor: where friction holds to, shape [rows, columns, 2] [m].
        spring: stiffness of a spring along z to ``height`` [N/m], shape [rows, columns]; None for none.
        height: where the springs end [m], shape [rows, columns].
    """

    areas: Array
    barrier: Array
    active: bool
    adhesion_pa: float = 0.0
    adhesion_range_m: float = 3e-3
    friction_force: Array | None = None
    anchor: Array | None = None
    spring: Array | None = None
    height: Array | None = None

    @classmethod
    def of(cls, areas: Array, weight_per_area: float, active: bool, adhesion_pa: float, range_m: float) -> PanelContact:
        """Barrier scaled by each vertex's own weight; ``weight_per_area`` [N/m²]."""
        return cls(areas, STIFFNESS_WEIGHTS * weight_per_area * areas * REACH_M, active, adhesion_pa, range_m)

    def numbers(self) -> Array:
        """What the kernels read, shape [rows, columns, 7]."""
        out = np.zeros((*self.areas.shape, pk.NUMBERS))
        out[..., pk.BARRIER] = self.barrier
        out[..., pk.ADHESION] = ADHESION_SHAPE * self.adhesion_pa * self.areas
        if self.friction_force is not None and self.anchor is not None:
            out[..., pk.FRICTION] = self.friction_force
            out[..., pk.ANCHOR_X : pk.ANCHOR_Y + 1] = self.anchor
        if self.spring is not None and self.height is not None:
            out[..., pk.SPRING] = self.spring
            out[..., pk.HEIGHT] = self.height
        return out

    def normal_force(self, x: Array, fixed: Mask) -> Array:
        """Push of the barrier on each vertex [N], shape [rows, columns]."""
        force = np.zeros(x.shape[:2])
        if self.active:
            where, t = _near(x, fixed, REACH_M)
            force[where] = -self.barrier[where] * _barrier_slope(t) / REACH_M
        return force

    def largest_step(self, x: Array, step: Array, fixed: Mask) -> float:
        """Largest multiple of ``step`` that leaves every free vertex at least a tenth of its height over the panel."""
        if not self.active:
            return math.inf
        z, dz = x[..., 2], step[..., 2]
        towards = (dz < 0.0) & (fixed == 0)
        return float((0.9 * z[towards] / -dz[towards]).min(initial=math.inf))

    def keep_clear(self, x: Array, moved: Array, fixed: Mask) -> Array:
        """``moved``, with no free vertex nearer the panel than a tenth of its distance in ``x``; changed in place."""
        if self.active:
            z = moved[..., 2]
            np.copyto(z, np.maximum(z, 0.1 * x[..., 2]), where=fixed == 0)
        return moved


def _near(x: Array, fixed: Mask, reach: float) -> tuple[tuple[NDArray[np.intp], ...], Array]:
    """Free vertices within ``reach`` of the panel and their distance in units of it."""
    where = np.nonzero((x[..., 2] < reach) & (fixed == 0))
    return where, x[..., 2][where] / reach


def _barrier_slope(t: Array) -> Array:
    return np.asarray(-(2.0 * (t - 1.0) * np.log(t) + (t - 1.0) ** 2 / t))
