"""One level of the solver: a grid with its constant operators and the sparsity pattern of its Hessian."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

OFFSETS: tuple[tuple[int, int], ...] = ((0, 0), (0, 1), (0, 2), (1, -1), (1, 0), (1, 1), (2, 0))
"""(rows, columns) from a vertex to the neighbours after it in its Hessian row: upper half of a 13-point stencil."""


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
    def pattern(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.intp]]:
        """CSR pattern of the upper triangle and which numbers of the vertices' stencils its values are.

        Returns:
            ``indptr`` int32 [3 n + 1], ``indices`` int32 [nonzeros], ``taken`` [nonzeros]: places in a flattened
            [rows, columns, 7, 3, 3] of blocks to the neighbours of ``OFFSETS``.
        """
        j, i = np.meshgrid(np.arange(self.rows), np.arange(self.columns), indexing="ij")
        dj, di = np.array(OFFSETS).T
        inside = (j[..., None] + dj < self.rows) & (i[..., None] + di < self.columns) & (i[..., None] + di >= 0)
        # row of the matrix (vertex, r), then neighbour, then column c of its block
        present = np.broadcast_to(inside[:, :, None, :, None], (self.rows, self.columns, 3, len(OFFSETS), 3)).copy()
        present[:, :, :, 0, :] &= np.triu(np.ones((3, 3), dtype=bool))
        row, r, neighbour, c = np.nonzero(present.reshape(-1, 3, len(OFFSETS), 3))
        indices = 3 * (row + (dj * self.columns + di)[neighbour]) + c
        indptr = np.zeros(3 * self.rows * self.columns + 1, dtype=np.int32)
        np.cumsum(np.bincount(3 * row + r, minlength=len(indptr) - 1), out=indptr[1:])
        taken = ((row * len(OFFSETS) + neighbour) * 3 + r) * 3 + c
        return indptr, indices.astype(np.int32), taken


def _second_difference_products(grid: Grid) -> tuple[NDArray[np.float64], ...]:
    """Upper-half stencils of the sums of area * x_uu.x_uu, x_vv.x_vv, 2 x_uu.x_vv and 4 x_uv.x_uv."""
    import scipy.sparse as sp

    rows, columns = grid.rows, grid.columns

    def band(n: int, *values: float) -> sp.csr_array:
        """Each row holds the values one after the other, starting on the diagonal; shape [n - len + 1, n]."""
        rows_out = n - len(values) + 1
        dense = np.zeros((rows_out, n))
        for k, value in enumerate(values):
            dense += value * np.eye(rows_out, n, k)
        return sp.csr_array(dense)

    def second(n: int, h: float) -> sp.csr_array:
        return band(n, h**-2, -2.0 * h**-2, h**-2)

    def first(n: int, h: float) -> sp.csr_array:
        return band(n, -1.0 / h, 1.0 / h)

    def weights(n: int, h: float) -> NDArray[np.float64]:
        w = np.full(n, h)
        w[[0, -1]] *= 0.5
        return w

    u2, v2 = second(columns, grid.hu), second(rows, grid.hv)
    inner_u, inner_v = sp.eye_array(columns).tocsr()[1:-1], sp.eye_array(rows).tocsr()[1:-1]
    area_u = sp.diags_array(np.kron(weights(rows, grid.hv), np.full(columns - 2, grid.hu)))
    area_v = sp.diags_array(np.kron(np.full(rows - 2, grid.hv), weights(columns, grid.hu)))
    d_uu = sp.kron(sp.eye_array(rows), u2).tocsr()
    d_vv = sp.kron(v2, sp.eye_array(columns)).tocsr()
    d_uv = sp.kron(first(rows, grid.hv), first(columns, grid.hu)).tocsr()
    inner_uu, inner_vv = sp.kron(inner_v, u2).tocsr(), sp.kron(v2, inner_u).tocsr()
    cell = grid.hu * grid.hv
    mixed = cell * (inner_uu.T @ inner_vv)
    forms = (d_uu.T @ area_u @ d_uu, d_vv.T @ area_v @ d_vv, mixed + mixed.T, 4.0 * cell * (d_uv.T @ d_uv))
    j, i = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    flat = j * columns + i
    result = []
    for form in forms:
        csr = sp.csr_matrix(form)
        stencil = np.zeros((rows, columns, len(OFFSETS)))
        for k, (dj, di) in enumerate(OFFSETS):
            inside = (j + dj < rows) & (i + di < columns) & (i + di >= 0)
            stencil[inside, k] = np.asarray(csr[flat[inside], (flat + dj * columns + di)[inside]]).ravel()
        result.append(stencil)
    return tuple(result)


@dataclass(frozen=True)
class BendingForms:
    """Stencils of the four quadratic forms that bending is a combination of, each shape [rows, columns, 7]."""

    uu: NDArray[np.float64]
    vv: NDArray[np.float64]
    mixed: NDArray[np.float64]
    twist: NDArray[np.float64]

    @classmethod
    def of(cls, grid: Grid) -> BendingForms:
        """Build them for a grid (once)."""
        return cls(*_second_difference_products(grid))

    def stencil(self, weft: float, warp: float, mixed: float, twist: float) -> NDArray[np.float64]:
        """Stencil of ∫ weft |x_uu|² + warp |x_vv|² + 2 mixed x_uu·x_vv + 4 twist |x_uv|² (twice the energy)."""
        return weft * self.uu + warp * self.vv + mixed * self.mixed + twist * self.twist
