"""The quadratic forms in second differences that bending is a combination of, as stencils of a grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.bending import PlateRigidity
from simcore.grid import OFFSETS, SKEW_OFFSETS, Grid

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BendingForms:
    """Stencils of the four forms of a plate whose axes are the sample's, each shape [rows, columns, 7].

    Attributes:
        grid: whose second differences they are.
        uu, vv, mixed, twist: ∫ |x_uu|², |x_vv|², 2 x_uu·x_vv, 4 |x_uv|² for unit coefficients.
    """

    grid: Grid
    uu: Array
    vv: Array
    mixed: Array
    twist: Array

    @classmethod
    def of(cls, grid: Grid) -> BendingForms:
        """Build them for a grid (once)."""
        d = _Differences.of(grid)
        mixed = d.cell * (d.inner_uu.T @ d.inner_vv)
        forms = (
            d.uu.T @ d.area_u @ d.uu, d.vv.T @ d.area_v @ d.vv, mixed + mixed.T, 4.0 * d.cell * (d.uv.T @ d.uv)
        )  # fmt: skip
        return cls(grid, *(_stencil(grid, form, OFFSETS) for form in forms))

    @cached_property
    def skew(self) -> tuple[Array, Array]:
        """Stencils of ∫ 4 x_uu·x_uv and 4 x_vv·x_uv over inner vertices, each shape [rows, columns, 11].

        x_uv at a vertex is the mean of its four cells', so that a plate with these terms stays positive where the
        continuum's is.
        """
        d = _Differences.of(self.grid)
        twisted = d.mean_of_cells @ d.uv
        result = []
        for bent in (d.inner_uu, d.inner_vv):
            form = 2.0 * d.cell * (bent.T @ twisted)
            result.append(_stencil(self.grid, form + form.T, (*OFFSETS, *SKEW_OFFSETS)))
        return result[0], result[1]

    def stencil(self, plate: PlateRigidity) -> tuple[Array, Array | None]:
        """Of twice the plate's energy [N/m]: to the neighbours of ``OFFSETS`` [rows, columns, 7] and, where bending and
        twist are coupled, to those of ``SKEW_OFFSETS`` [rows, columns, 4]."""
        plain = plate.weft * self.uu + plate.warp * self.vv + plate.coupling * self.mixed + plate.twist * self.twist
        if plate.weft_twist == 0.0 and plate.warp_twist == 0.0:
            return plain, None
        by_weft, by_warp = self.skew
        coupled = plate.weft_twist * by_weft + plate.warp_twist * by_warp
        inside = len(OFFSETS)
        return plain + coupled[..., :inside], np.ascontiguousarray(coupled[..., inside:])


@dataclass(frozen=True)
class _Differences:
    """Sparse second differences of one coordinate, vertices numbered row by row, with the areas they stand for [m²].

    Attributes:
        uu, vv: where they fit.
        uv: of every cell.
        inner_uu, inner_vv: at inner vertices.
        mean_of_cells: from cells to inner vertices.
        area_u, area_v: of the rows of ``uu`` and ``vv``.
        cell: area of a cell.
    """

    uu: Any
    vv: Any
    uv: Any
    inner_uu: Any
    inner_vv: Any
    mean_of_cells: Any
    area_u: Any
    area_v: Any
    cell: float

    @classmethod
    def of(cls, grid: Grid) -> _Differences:
        import scipy.sparse as sp

        rows, columns, hu, hv = grid.rows, grid.columns, grid.hu, grid.hv

        def band(n: int, *values: float) -> sp.csr_array:
            """Each row holds the values one after the other, starting on the diagonal; shape [n - len + 1, n]."""
            out = n - len(values) + 1
            dense = np.zeros((out, n))
            for k, value in enumerate(values):
                dense += value * np.eye(out, n, k)
            return sp.csr_array(dense)

        def second(n: int, h: float) -> sp.csr_array:
            return band(n, h**-2, -2.0 * h**-2, h**-2)

        def weights(n: int, h: float) -> Array:
            w = np.full(n, h)
            w[[0, -1]] *= 0.5
            return w

        u2, v2 = second(columns, hu), second(rows, hv)
        inner_u, inner_v = sp.eye_array(columns).tocsr()[1:-1], sp.eye_array(rows).tocsr()[1:-1]
        return cls(
            uu=sp.kron(sp.eye_array(rows), u2).tocsr(),
            vv=sp.kron(v2, sp.eye_array(columns)).tocsr(),
            uv=sp.kron(band(rows, -1.0 / hv, 1.0 / hv), band(columns, -1.0 / hu, 1.0 / hu)).tocsr(),
            inner_uu=sp.kron(inner_v, u2).tocsr(),
            inner_vv=sp.kron(v2, inner_u).tocsr(),
            mean_of_cells=sp.kron(band(rows - 1, 0.5, 0.5), band(columns - 1, 0.5, 0.5)).tocsr(),
            area_u=sp.diags_array(np.kron(weights(rows, hv), np.full(columns - 2, hu))),
            area_v=sp.diags_array(np.kron(np.full(rows - 2, hv), weights(columns, hu))),
            cell=hu * hv,
        )


def _stencil(grid: Grid, form: Any, offsets: Sequence[tuple[int, int]]) -> Array:
    """A symmetric matrix over the vertices as its upper half, [rows, columns, offsets]."""
    import scipy.sparse as sp

    csr = sp.csr_matrix(form)
    j, i = np.meshgrid(np.arange(grid.rows), np.arange(grid.columns), indexing="ij")
    flat = j * grid.columns + i
    out = np.zeros((grid.rows, grid.columns, len(offsets)))
    for k, (dj, di) in enumerate(offsets):
        inside = (j + dj < grid.rows) & (i + di < grid.columns) & (i + di >= 0)
        out[inside, k] = np.asarray(csr[flat[inside], (flat + dj * grid.columns + di)[inside]]).ravel()
    return out
