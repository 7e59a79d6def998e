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


LEAF = 104
"""Largest matrix that a library factors as a whole; larger ones are halved, and most of the work is products."""


@dataclass
class Factors:
    """L Lᵀ of n matrices. The diagonal blocks of L are kept inverted: solving then takes products alone, which on a GPU
    cost a quarter of substitutions with one right side.

    Attributes:
        inverse: of the lower triangular blocks on the diagonal, one tensor [n, m, m] a block of two rows.
        below: blocks under them, one tensor [n, m, m] less.
        length: rows and columns of a matrix without the padding.
    """

    inverse: list[Tensor]
    below: list[Tensor]
    length: int

    def solve(self, right: Tensor) -> Tensor:
        """Solve for one right side each, shape [n, length]."""
        m = self.inverse[0].shape[1]
        padded = torch.nn.functional.pad(right, (0, m * len(self.inverse) - self.length))
        parts = list(padded.reshape(len(right), len(self.inverse), m, 1).unbind(1))
        for k, inverse in enumerate(self.inverse):
            if k > 0:
                parts[k] = torch.baddbmm(parts[k], self.below[k - 1], parts[k - 1], alpha=-1.0)
            parts[k] = inverse @ parts[k]
        for k in reversed(range(len(parts))):
            if k + 1 < len(parts):
                parts[k] = torch.baddbmm(parts[k], self.below[k].mT, parts[k + 1], alpha=-1.0)
            parts[k] = self.inverse[k].mT @ parts[k]
        return torch.stack(parts, dim=1).reshape(len(right), -1)[:, : self.length].contiguous()

    def put(self, rows: Tensor, others: Factors) -> None:
        """Replace the factors of some matrices (their numbers, [k])."""
        for mine, theirs in zip(self.inverse + self.below, others.inverse + others.below, strict=True):
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
        flat = stencils.reshape(len(stencils), -1)
        good = torch.ones(len(stencils), dtype=torch.bool, device=stencils.device)
        inverses: list[Tensor] = []
        below: list[Tensor] = []
        for k in range(self._blocks):
            block = self._block(flat, self._inside[k])
            if k == self._blocks - 1:
                block.view(len(flat), -1)[:, self._padding] = 1.0
            if k > 0:
                block.baddbmm_(below[-1], below[-1].mT, alpha=-1.0)
            inverse, fine = invert_factor(block)
            good &= fine
            inverses.append(inverse)
            if k + 1 < self._blocks:
                below.append(self._block(flat, self._across[k]) @ inverse.mT)
        return Factors(inverses, below, self._length), good

    def _block(self, flat: Tensor, places: tuple[Tensor, Tensor]) -> Tensor:
        source, target = places
        block = torch.zeros((len(flat), self._size * self._size), dtype=flat.dtype, device=flat.device)
        block[:, target] = flat[:, source]
        return block.view(-1, self._size, self._size)


def invert_factor(blocks: Tensor, leaf: int = LEAF) -> tuple[Tensor, Tensor]:
    """Invert the Cholesky factors of matrices.

    Args:
        blocks: [n, m, m], of which the lower triangles are read; changed.
        leaf: see :data:`LEAF`.

    Returns:
        The inverses of the factors [n, m, m], and which matrices are positive definite [n]; for others
        they mean nothing.
    """
    n, m = blocks.shape[:2]
    if m <= leaf:
        lower, info = torch.linalg.cholesky_ex(blocks)
        eye = torch.eye(m, dtype=blocks.dtype, device=blocks.device).expand(n, m, m)
        return torch.linalg.solve_triangular(lower, eye, upper=False), info == 0
    half = m // 2
    first, fine = invert_factor(blocks[:, :half, :half], leaf)
    across = blocks[:, half:, :half] @ first.mT
    rest = torch.baddbmm(blocks[:, half:, half:], across, across.mT, alpha=-1.0)
    second, fine_too = invert_factor(rest, leaf)
    inverse = torch.zeros_like(blocks)
    inverse[:, :half, :half] = first
    inverse[:, half:, half:] = second
    torch.bmm(second, across @ first, out=inverse[:, half:, :half])
    inverse[:, half:, :half].neg_()
    return inverse, fine & fine_too
