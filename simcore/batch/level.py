"""One grid of the cascade with the cloths of a batch on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from simcore.batch.cholesky import BlockCholesky, Factors
from simcore.batch.device import Device
from simcore.bending_forms import BendingForms
from simcore.cloths import Cloths
from simcore.grid import SKEW_OFFSETS, Grid
from simcore.model import Model
from simcore.panel_kernels import BEHIND

Tensor = torch.Tensor


class BatchLevel:
    """Energy, gradient and factored Hessian of up to ``most`` cloths at once, out of any number that are set up.

    ``which`` [n] (int64) says of which cloth each of n positions [n, rows, columns, 3] is.
    """

    def __init__(self, grid: Grid, device: Device, most: int) -> None:
        self.grid = grid
        self.device = device
        self.most = most
        self.forms = BendingForms.of(grid)
        self._model = Model(grid, most, device.zeros)
        self._cholesky = BlockCholesky(grid, device)
        self._skew_cholesky: BlockCholesky | None = None

    def set_up(self, cloths: Sequence[Cloths], weights: NDArray[np.float64]) -> None:
        """Choose the cloths; ``weights`` are those of an inner vertex [N], the units of residuals."""
        self.cloths = Cloths.stack(cloths).on(self.device.put)
        self._base_load = self.cloths.load.clone()
        self.free = (self.cloths.fixed == 0)[..., None]
        counts = self.free.sum(dim=(1, 2, 3)).clamp(min=1)
        self._unit = torch.sqrt(counts.to(torch.float64)) * self.device.put(weights)
        self.weights = self.device.put(weights)
        self.panel = self.device.put(np.array([bool(c.settings[0, -1]) for c in cloths]))

    def push(self, force: Tensor | float) -> None:
        """Add this force to every vertex from now on, in place of the last one [N]."""
        self.cloths.load.copy_(self._base_load + force)

    def energies(self, which: Tensor, x: Tensor) -> Tensor:
        """[J], [n]; infinite behind the panel."""
        energy: Tensor = self._model.energies(self.cloths, which.to(torch.int32), x)
        return torch.where(energy < BEHIND, energy, torch.inf)

    def gradients(self, which: Tensor, x: Tensor) -> Tensor:
        """[N], zero where held."""
        gradient: Tensor = self._model.gradients(self.cloths, which.to(torch.int32), x)
        return gradient

    def residuals(self, which: Tensor, gradient: Tensor) -> Tensor:
        """RMS out-of-balance force per free vertex [vertex weights], [n]."""
        return torch.sqrt((gradient * gradient).sum(dim=(1, 2, 3))) / self._unit[which]

    def factor(self, which: Tensor, x: Tensor, blend: Tensor, shift: Tensor) -> tuple[Factors, Tensor]:
        """Factors of the blended Hessians plus ``shift`` [N/m], [n] or [n, rows, columns]; whether each is positive."""
        if shift.ndim == 1:
            shift = shift[:, None, None].expand(x.shape[:3])
        stencils = self._model.hessians(self.cloths, which.to(torch.int32), x, blend, shift.contiguous())
        if self.cloths.skew is None:
            return self._cholesky.factor(stencils)
        if self._skew_cholesky is None:
            self._skew_cholesky = BlockCholesky(self.grid, self.device, SKEW_OFFSETS)
        eye = torch.eye(3, dtype=stencils.dtype, device=stencils.device)
        skew = self.cloths.skew_between_free(which)[..., None, None] * eye
        return self._skew_cholesky.factor(torch.cat([stencils, skew], dim=3))

    def solve(self, factors: Factors, right: Tensor) -> Tensor:
        """Solve; shapes [n, rows, columns, 3]."""
        return factors.solve(right.reshape(len(right), -1)).reshape(right.shape)

    def keep_clear(self, which: Tensor, x: Tensor, moved: Tensor) -> Tensor:
        """``moved``, with no free vertex nearer the panel than a tenth of its distance in ``x``; changed in place."""
        z = moved[..., 2]
        guarded = self.free[which][..., 0] & self.panel[which][:, None, None]
        moved[..., 2] = torch.where(guarded, torch.maximum(z, 0.1 * x[..., 2]), z)
        return moved

    def largest_steps(self, which: Tensor, x: Tensor, step: Tensor) -> Tensor:
        """Largest multiple of each step that leaves every free vertex at least a tenth of its height over the panel."""
        z, dz = x[..., 2], step[..., 2]
        towards = (dz < 0.0) & self.free[which][..., 0] & self.panel[which][:, None, None]
        allowed = torch.where(towards, 0.9 * z / (-dz).clamp(min=1e-300), torch.inf)
        return allowed.amin(dim=(1, 2))
