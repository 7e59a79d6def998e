"""A smooth surface through the vertices of a regular grid, so that pictures do not show the mesh.

Between vertices a coarse mesh is flat: folds a few cells wide are drawn as facets, and folds that run along the
diagonal of the cells look like beads. A drape is smooth, and its vertices are all that is known of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simcore.errors import InputError

SMOOTH_CELLS = 100
"""Cells along the longer side that are fine enough for a picture: 5 mm on a sample of 0.5 m, as the paper's."""

_FRONT_M = -1e-5


@dataclass(frozen=True)
class RefinedSurface:
    """Vertices [m], float64 [V, 3]; triangles int32 [T, 3]; texture coordinates float64 [V, 2]."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    uv: NDArray[np.float64]


def grid_shape(uv: ArrayLike) -> tuple[int, int] | None:
    """Rows and columns of the regular grid whose texture coordinates these are (``GridMesh.uv``); None if of none."""
    coordinates = np.asarray(uv, dtype=np.float64)
    if coordinates.ndim != 2 or coordinates.shape[1] != 2 or len(coordinates) < 4:
        return None
    columns = int(np.argmax(coordinates[:, 1] > coordinates[0, 1]))
    if columns < 2 or len(coordinates) % columns:
        return None
    rows = len(coordinates) // columns
    expected = _grid_uv(rows, columns)
    return (rows, columns) if rows > 1 and np.allclose(coordinates, expected, atol=1e-9) else None


def refine_grid(vertices: ArrayLike, uv: ArrayLike, cells: int = SMOOTH_CELLS) -> RefinedSurface:
    """Bicubic spline through the vertices of a regular grid, sampled on whole parts of its cells.

    The grid's vertices stay where they are. A drape before the panel (z >= 0) stays before it: what the spline would
    put behind is laid on it.

    Args:
        vertices: [m], panel frame, shape [rows * columns, 3].
        uv: texture coordinates in [0, 1], ``GridMesh.uv``, shape [rows * columns, 2].
        cells: cut until the longer side has at least this many cells; a grid that is fine already is left as it is.

    Raises:
        InputError: ``uv`` is not that of a regular grid of these vertices, or vertices are not finite.
    """
    from scipy.interpolate import RectBivariateSpline

    x = np.asarray(vertices, dtype=np.float64)
    shape = grid_shape(uv)
    if shape is None or x.shape != (shape[0] * shape[1], 3):
        raise InputError("uv must be that of a regular grid of the vertices: pass GridMesh.uv", code="mesh_not_grid")
    if not np.all(np.isfinite(x)):
        raise InputError("vertices are not finite: use only drapes whose status is 'still'", code="mesh_not_finite")
    rows, columns = shape
    factor = max(1, -(-cells // (max(rows, columns) - 1)))
    fine_rows, fine_columns = (rows - 1) * factor + 1, (columns - 1) * factor + 1
    uv_fine, triangles = _grid_uv(fine_rows, fine_columns), _grid_triangles(fine_rows, fine_columns)
    if factor == 1:
        return RefinedSurface(x, triangles, uv_fine)
    v, u = np.arange(rows), np.arange(columns)
    fine_v, fine_u = np.arange(fine_rows) / factor, np.arange(fine_columns) / factor
    order_v, order_u = min(3, rows - 1), min(3, columns - 1)
    fine = np.stack(
        [
            RectBivariateSpline(v, u, x[:, axis].reshape(rows, columns), kx=order_v, ky=order_u)(fine_v, fine_u)
            for axis in range(3)
        ],
        axis=2,
    )
    fine[::factor, ::factor] = x.reshape(rows, columns, 3)
    if x[:, 2].min() >= _FRONT_M:
        np.maximum(fine[..., 2], min(0.0, x[:, 2].min()), out=fine[..., 2])
    return RefinedSurface(fine.reshape(-1, 3), triangles, uv_fine)


def _grid_uv(rows: int, columns: int) -> NDArray[np.float64]:
    v, u = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns), indexing="ij")
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _grid_triangles(rows: int, columns: int) -> NDArray[np.int32]:
    """Alternating diagonals, counter-clockwise seen from +z with v downwards, int32 [T, 3]."""
    j, i = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (j * columns + i).ravel()
    b, c, d = a + 1, a + columns, a + columns + 1
    even = ((i + j) % 2 == 0).ravel()[:, None]
    first = np.where(even, np.stack([a, c, d], 1), np.stack([a, c, b], 1))
    second = np.where(even, np.stack([a, d, b], 1), np.stack([b, c, d], 1))
    return np.concatenate([first, second]).astype(np.int32)
