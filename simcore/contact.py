"""What the panel does to each vertex on its own: barrier, adhesion, friction."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.int32]

REACH_M = 1e-3
"""Distance from the panel at which it begins to push [m]."""
STIFFNESS_WEIGHTS = 5.0
"""Barrier energy scale: this many vertex weights times the reach."""
SLIP_M = 5e-4
"""Displacement over which friction builds up [m]."""
ADHESION_SHAPE = 3.0 * math.sqrt(3.0) / 8.0
"""Makes the steepest slope of (1 - t²)² one."""


@dataclass(frozen=True)
class PanelContact:
    """Energy of single vertices by their place over the panel.

    Barrier: -s (t - 1)² ln t, t = z / reach, of incremental potential contact (Li et al. 2020, eq. 6).
    Adhesion: -c p r A (1 - t²)², t = z / r: a pull that rises to the pressure p and is gone at the range r.
    Friction: mu N sqrt(|d|² + slip²), d the shift in the panel's plane from ``anchor`` under the lagged normal force N.

    Attributes:
        areas: of the vertices [m²], shape [rows, columns].
        barrier: s of each vertex [J].
        active: whether there is a panel.
        adhesion_pa, adhesion_range_m: p and r; 0 for none.
        friction_force: mu N [N], shape [rows, columns]; None for none.
        anchor: where friction holds to, shape [rows, columns, 2] [m].
    """

    areas: Array
    barrier: Array
    active: bool
    adhesion_pa: float = 0.0
    adhesion_range_m: float = 3e-3
    friction_force: Array | None = None
    anchor: Array | None = None

    @classmethod
    def of(cls, areas: Array, weight_per_area: float, active: bool, adhesion_pa: float, range_m: float) -> PanelContact:
        """Barrier scaled by each vertex's own weight; ``weight_per_area`` [N/m²]."""
        return cls(areas, STIFFNESS_WEIGHTS * weight_per_area * areas * REACH_M, active, adhesion_pa, range_m)

    def energy(self, x: Array, fixed: Mask) -> float:
        """[J]; infinite where a free vertex is at or behind the panel."""
        if not self.active:
            return 0.0
        total = 0.0
        where, t = _near(x, fixed, REACH_M)
        if t.size:
            if t.min() <= 0.0:
                return math.inf
            total -= float((self.barrier[where] * (t - 1.0) ** 2 * np.log(t)).sum())
        if self.adhesion_pa:
            where, t = _near(x, fixed, self.adhesion_range_m)
            total -= float((self._adhesion(where) * self.adhesion_range_m * (1.0 - t * t) ** 2).sum())
        if self.friction_force is not None:
            _, root = self._slip(x)
            total += float((self.friction_force * (root - SLIP_M)).sum())
        return total

    def add_gradient(self, x: Array, fixed: Mask, gradient: Array) -> None:
        """Add the derivative to ``gradient`` [N]."""
        if not self.active:
            return
        where, t = _near(x, fixed, REACH_M)
        gradient[..., 2][where] += self.barrier[where] * _barrier_slope(t) / REACH_M
        if self.adhesion_pa:
            where, t = _near(x, fixed, self.adhesion_range_m)
            gradient[..., 2][where] += 4.0 * self._adhesion(where) * t * (1.0 - t * t)
        if self.friction_force is not None:
            shift, root = self._slip(x)
            gradient[..., :2] += (self.friction_force / root * (fixed == 0))[..., None] * shift

    def hessian(self, x: Array, fixed: Mask, blend: float) -> Array:
        """Vertex blocks (xx, yy, zz, xy, xz, yz) [N/m], shape [rows, columns, 6]; negative parts times ``blend``."""
        blocks = np.zeros((*x.shape[:2], 6))
        if not self.active:
            return blocks
        where, t = _near(x, fixed, REACH_M)
        stiffness = -(2.0 * np.log(t) + 4.0 * (t - 1.0) / t - (t - 1.0) ** 2 / t**2)
        blocks[..., 2][where] = self.barrier[where] * stiffness / REACH_M**2
        if self.adhesion_pa:
            where, t = _near(x, fixed, self.adhesion_range_m)
            bend = 4.0 * self._adhesion(where) * (1.0 - 3.0 * t * t) / self.adhesion_range_m
            blocks[..., 2][where] += np.where(bend > 0.0, bend, blend * bend)
        if self.friction_force is not None:
            shift, root = self._slip(x)
            stiff = self.friction_force / root * (fixed == 0)
            unit = shift / root[..., None]
            blocks[..., 0] += stiff * (1.0 - unit[..., 0] ** 2)
            blocks[..., 1] += stiff * (1.0 - unit[..., 1] ** 2)
            blocks[..., 3] -= stiff * unit[..., 0] * unit[..., 1]
        return blocks

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

    def _adhesion(self, where: tuple[NDArray[np.intp], ...]) -> Array:
        return np.asarray(ADHESION_SHAPE * self.adhesion_pa * self.areas[where])

    def _slip(self, x: Array) -> tuple[Array, Array]:
        assert self.anchor is not None
        shift = x[..., :2] - self.anchor
        return shift, np.sqrt((shift**2).sum(axis=2) + SLIP_M**2)


def _near(x: Array, fixed: Mask, reach: float) -> tuple[tuple[NDArray[np.intp], ...], Array]:
    """Free vertices within ``reach`` of the panel and their distance in units of it."""
    where = np.nonzero((x[..., 2] < reach) & (fixed == 0))
    return where, x[..., 2][where] / reach


def _barrier_slope(t: Array) -> Array:
    return np.asarray(-(2.0 * (t - 1.0) * np.log(t) + (t - 1.0) ** 2 / t))
