"""The panel: a smooth barrier that keeps every free vertex at z > 0."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REACH_M = 1e-3
"""Distance from the panel at which it begins to push [m]."""
STIFFNESS_WEIGHTS = 5.0
"""Barrier energy scale: this many vertex weights times the reach."""


@dataclass(frozen=True)
class PanelContact:
    """Logarithmic barrier -s (t - 1)² ln t, t = z / reach, of incremental potential contact (Li et al. 2020, eq. 6).

    Attributes:
        scale: s of each vertex [J], shape [rows, columns]; all zero where there is no panel.
        reach_m: where it begins.
    """

    scale: Array
    reach_m: float = REACH_M
    active: bool = True

    @classmethod
    def of(cls, areas: Array, weight_per_area: float, active: bool) -> PanelContact:
        """Scale by each vertex's own weight; ``weight_per_area`` [N/m²]."""
        return cls(STIFFNESS_WEIGHTS * weight_per_area * areas * REACH_M, REACH_M, active)

    def _near(self, x: Array, fixed: NDArray[np.int32]) -> tuple[tuple[NDArray[np.intp], ...], Array]:
        where = np.nonzero((x[..., 2] < self.reach_m) & (fixed == 0))
        return where, x[..., 2][where] / self.reach_m

    def energy(self, x: Array, fixed: NDArray[np.int32]) -> float:
        """Barrier energy [J]; infinite where a free vertex is at or behind the panel."""
        if not self.active:
            return 0.0
        where, t = self._near(x, fixed)
        if t.size == 0:
            return 0.0
        if t.min() <= 0.0:
            return math.inf
        return float(-(self.scale[where] * (t - 1.0) ** 2 * np.log(t)).sum())

    def add_gradient(self, x: Array, fixed: NDArray[np.int32], gradient: Array) -> None:
        """Add its derivative by z to ``gradient`` [N]."""
        if not self.active:
            return
        where, t = self._near(x, fixed)
        force = -(2.0 * (t - 1.0) * np.log(t) + (t - 1.0) ** 2 / t)
        gradient[..., 2][where] += self.scale[where] * force / self.reach_m

    def hessian(self, x: Array, fixed: NDArray[np.int32]) -> Array:
        """Vertex blocks (xx, yy, zz, xy, xz, yz) [N/m], shape [rows, columns, 6]; positive."""
        blocks = np.zeros((*x.shape[:2], 6))
        if self.active:
            where, t = self._near(x, fixed)
            stiffness = -(2.0 * np.log(t) + 4.0 * (t - 1.0) / t - (t - 1.0) ** 2 / t**2)
            blocks[..., 2][where] = self.scale[where] * stiffness / self.reach_m**2
        return blocks

    def largest_step(self, x: Array, step: Array, fixed: NDArray[np.int32]) -> float:
        """Largest multiple of ``step`` that leaves every free vertex at least a tenth of its height over the panel."""
        if not self.active:
            return math.inf
        z, dz = x[..., 2], step[..., 2]
        towards = (dz < 0.0) & (fixed == 0)
        if not towards.any():
            return math.inf
        return float((0.9 * z[towards] / -dz[towards]).min())
