"""Cholesky of many Hessians of one grid: block tridiagonal, two rows of vertices a block.

A vertex is coupled to vertices at most two rows away, so blocks of two rows are coupled to the next one alone. The
factorisation exists exactly when the matrix is positive definite: that certifies a minimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from simcore.batch.device import Device
from simcore.grid import OFFSETS, Grid

Tensor = torch.Tensor


@dataclass
class Factors:
    """L Lᵀ of n matrices.

    Attributes:
        diagonal: lower triangular blocks, one tensor [n, m, m] a block of two rows.
        below: blocks under them, one tensor [n, m, m] less.
        length: rows and columns of a matrix without the padding.
    """

    diagonal: list[Tensor]
    below: list[Tensor]
    length: int

    def solve(self, right: Tensor) -> Tensor:
        """Solve for one right side each, shape [n, length]."""
        m = self.diagonal[0].shape[1]
        padded = torch.nn.functional.pad(right, (0, m * len(self.diagonal) - self.length))
        parts = list(padded.reshape(len(right), len(self.diagonal), m, 1).unbind(1))
        for k, lower in enumerate(self.diagonal):
            if k > 0:
                parts[k] = parts[k] - self.below[k - 1] @ parts[k - 1]
            parts[k] = torch.linalg.solve_triangular(lower, parts[k], upper=False)
        for k in reversed(range(len(parts))):
            if k + 1 < len(parts):
                parts[k] = parts[k] - self.below[k].mT @ parts[k + 1]
            parts[k] = torch.linalg.solve_triangular(self.diagonal[k].mT, parts[k], upper=True)
        return torch.stack(parts, dim=1).reshape(len(right), -1)[:, : self.length].contiguous()

    def put(self, rows: Tensor, others: Factors) -> None:
        """Replace the factors of some matrices (their numbers, [k])."""
        for mine, theirs in zip(self.diagonal + self.below, others.diagonal + others.below, strict=True):
            mine[rows] = theirs


class BlockCholesky:
    """Knows where a grid's stencils go; :meth:`factor` does the work.

    ``further`` neighbours come in the stencils after those of ``OFFSETS``.
    """

    def __init__(self, grid: Grid, device: Device, further: tuple[tuple[int, int], ...] = ()) -> None:
        offsets = (*OFFSETS, *further)
        self._length = 3 * grid.rows * grid.columns
        self._size = 6 * grid.columns
        self._blocks = (grid.rows + 1) // 2
        rows, columns = np.meshgrid(np.arange(grid.rows), np.arange(grid.columns), indexing="ij")
        inside: list[tuple[np.ndarray, ...]] = []
        across: list[tuple[np.ndarray, ...]] = []
        for number, (dj, di) in enumerate(offsets):
            present = (rows + dj < grid.rows) & (columns + di < grid.columns) & (columns + di >= 0)
            j, i = rows[present], columns[present]
            for r in range(3):
                for c in range(3):
                    source = (j * grid.columns + i) * 9 * len(offsets) + 9 * number + 3 * r + c
                    own = 3 * ((j % 2) * grid.columns + i) + r
                    other = 3 * (((j + dj) % 2) * grid.columns + i + di) + c
                    same = j // 2 == (j + dj) // 2
                    inside.append((source[same], j[same] // 2, other[same], own[same]))
                    across.append((source[~same], j[~same] // 2, other[~same], own[~same]))
        self._inside = self._places(inside, device)
        self._across = self._places(across, device)
        odd = grid.rows % 2 == 1
        padding = np.arange(3 * grid.columns, self._size) if odd else np.zeros(0, dtype=np.int64)
        self._padding = device.put(padding * (self._size + 1))

    def _places(self, parts: Sequence[tuple[np.ndarray, ...]], device: Device) -> list[tuple[Tensor, Tensor]]:
        """For each block where its numbers come from in a flat stencil and where they go in the flat block."""
        source, block, row, column = (np.concatenate([p[k] for p in parts]) for k in range(4))
        places = []
        for number in range(self._blocks):
            mine = block == number
            places.append((device.put(source[mine]), device.put(row[mine] * self._size + column[mine])))
        return places

    def factor(self, stencils: Tensor) -> tuple[Factors, Tensor]:
        """Factor.

        Args:
            stencils: [n, rows, columns, 7 and as many as there are further neighbours, 3, 3].

        Returns:
            The factors, and which matrices are positive definite (bool [n]); factors of the others mean nothing.
        """
        n, m = len(stencils), self._size
        flat = stencils.reshape(n, -1)
        good = torch.ones(n, dtype=torch.bool, device=stencils.device)
        diagonal: list[Tensor] = []
        below: list[Tensor] = []
        for k in range(self._blocks):
            block = self._block(flat, self._inside[k])
            if k == self._blocks - 1:
                block.view(n, -1)[:, self._padding] = 1.0
            block = torch.tril(block) + torch.tril(block, -1).mT
            if k > 0:
                block = torch.baddbmm(block, below[-1], below[-1].mT, alpha=-1.0)
            lower, info = torch.linalg.cholesky_ex(block)
            bad = info != 0
            good &= ~bad
            # a broken factor must not spread infinities: its matrix is done with
            lower = torch.where(bad[:, None, None], torch.eye(m, dtype=lower.dtype, device=lower.device), lower)
            diagonal.append(lower)
            if k + 1 < self._blocks:
                coupling = self._block(flat, self._across[k])
                coupling[bad] = 0.0
                below.append(torch.linalg.solve_triangular(lower.mT, coupling, upper=True, left=False))
        return Factors(diagonal, below, self._length), good

    def _block(self, flat: Tensor, places: tuple[Tensor, Tensor]) -> Tensor:
        source, target = places
        block = torch.zeros((len(flat), self._size * self._size), dtype=flat.dtype, device=flat.device)
        block[:, target] = flat[:, source]
        return block.view(-1, self._size, self._size)
