"""One level of the solver: a grid with its constant operators and the sparsity pattern of its Hessian."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

OFFSETS: tuple[tuple[int, int], ...] = ((0, 0), (0, 1), (0, 2), (1, -1), (1, 0), (1, 1), (2, 0))
"""(rows, columns) from a vertex to the neighbours after it in its Hessian row: upper half of a 13-point stencil."""
SKEW_OFFSETS: tuple[tuple[int, int], ...] = ((1, -2), (1, 2), (2, -1), (2, 1))
"""Further ones, to which each coordinate is coupled with itself where bending is coupled with twist."""


@dataclass(frozen=True)
class Grid:
    """``rows x columns`` vertices with cells of ``hu x hv`` metres (u along a row, v down the rows)."""

    rows: int
    columns: int
    hu: float
    hv: float

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of a position array: (rows, columns, 3)."""
        return (self.rows, self.columns, 3)

    @cached_property
    def areas(self) -> NDArray[np.float64]:
        """Area that each vertex stands for [m²], shape [rows, columns]."""
        along_u = np.full(self.columns, self.hu)
        along_v = np.full(self.rows, self.hv)
        along_u[[0, -1]] *= 0.5
        along_v[[0, -1]] *= 0.5
        return np.outer(along_v, along_u)

    @cached_property
    def rest(self) -> NDArray[np.float64]:
        """The flat sample in the panel frame with its top edge on y = 0, centred on x = 0; shape [rows, columns, 3]."""
        x = np.zeros(self.shape)
        x[..., 0] = (np.arange(self.columns) - 0.5 * (self.columns - 1)) * self.hu
        x[..., 1] = -(np.arange(self.rows) * self.hv)[:, None]
        return x

    @cached_property
    def pattern(self) -> Pattern:
        """Of a Hessian with the neighbours of ``OFFSETS``."""
        return Pattern.of(self, ())

    @cached_property
    def skew_pattern(self) -> Pattern:
        """Of a Hessian with the neighbours of ``OFFSETS`` and ``SKEW_OFFSETS``."""
        return Pattern.of(self, SKEW_OFFSETS)


@dataclass(frozen=True)
class Pattern:
    """Where the numbers of a Hessian stand: CSR of its upper triangle, int32.

    Attributes:
        indptr, indices: row starts [3 n + 1] and columns [nonzeros], sorted, each row starting with its diagonal.
        places, taken: the nonzeros (None: all) that come from a flattened [rows, columns, 7, 3, 3] of blocks to the
            neighbours of ``OFFSETS``, and which numbers of those they are.
        skew_places, skew_taken: likewise from a flattened [rows, columns, 4] to those of ``SKEW_OFFSETS``.
    """

    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    places: NDArray[np.intp] | None
    taken: NDArray[np.intp]
    skew_places: NDArray[np.intp]
    skew_taken: NDArray[np.intp]

    @classmethod
    def of(cls, grid: Grid, further: tuple[tuple[int, int], ...]) -> Pattern:
        """For the neighbours of ``OFFSETS`` and ``further`` ones."""
        rows, columns, plain = grid.rows, grid.columns, len(OFFSETS)
        numbers = sorted(range(plain + len(further)), key=lambda k: (*OFFSETS, *further)[k])
        dj, di = np.array([(*OFFSETS, *further)[k] for k in numbers]).T
        j, i = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
        inside = (j[..., None] + dj < rows) & (i[..., None] + di < columns) & (i[..., None] + di >= 0)
        # row of the matrix (vertex, r), then neighbour, then column c of its block
        present = np.broadcast_to(inside[:, :, None, :, None], (rows, columns, 3, len(numbers), 3)).copy()
        present[:, :, :, 0, :] &= np.triu(np.ones((3, 3), dtype=bool))
        present[:, :, :, np.array(numbers) >= plain, :] &= np.eye(3, dtype=bool)[:, None, :]
        vertex, r, neighbour, c = np.nonzero(present.reshape(-1, 3, len(numbers), 3))
        indices = 3 * (vertex + (dj * columns + di)[neighbour]) + c
        indptr = np.zeros(3 * rows * columns + 1, dtype=np.int32)
        np.cumsum(np.bincount(3 * vertex + r, minlength=len(indptr) - 1), out=indptr[1:])
        number = np.array(numbers)[neighbour]
        own, skew = number < plain, np.flatnonzero(number >= plain)
        taken = ((vertex[own] * plain + number[own]) * 3 + r[own]) * 3 + c[own]
        skew_taken = vertex[skew] * len(SKEW_OFFSETS) + number[skew] - plain
        places = None if own.all() else np.flatnonzero(own)
        return cls(indptr, indices.astype(np.int32), places, taken, skew, skew_taken)

    def values(self, stencil: NDArray[np.float64], skew: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """The nonzeros, [nonzeros]."""
        if self.places is None or skew is None:
            return stencil.ravel().take(self.taken)
        values = np.empty(len(self.indices))
        values[self.places] = stencil.ravel().take(self.taken)
        values[self.skew_places] = skew.ravel().take(self.skew_taken)
        return values
