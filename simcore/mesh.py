"""The regular grid that stands for the sample."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError


@dataclass(frozen=True)
class GridMesh:
    """A rectangular sample cut into square cells.

    Vertex ``(j, i)`` of ``rows x columns`` has material coordinates ``u = i * resolution`` from the left edge along
    weft and ``v = j * resolution`` from the top edge along warp, both [m]; its flat index is ``j * columns + i``.

    Attributes:
        resolution_m: edge of a cell [m].
        size_m: width (u) and height (v) [m].

    Raises:
        InputError: the resolution does not divide the sample, or is absurd.
    """

    resolution_m: float
    size_m: tuple[float, float] = (0.5, 0.5)

    def __post_init__(self) -> None:
        h = self.resolution_m
        if not 1e-3 <= h <= 0.1:
            raise InputError(f"resolution {h} m must be from 0.001 to 0.1 m", code="resolution_out_of_range")
        for length in self.size_m:
            cells = length / h
            if abs(cells - round(cells)) > 1e-6 or round(cells) < 4:
                raise InputError(
                    f"resolution {h} m does not divide the sample's {length} m into at least 4 whole cells: "
                    f"try {length / max(4, round(cells)):.9g}",
                    code="resolution_does_not_divide",
                )

    @property
    def columns(self) -> int:
        """Vertices along u."""
        return round(self.size_m[0] / self.resolution_m) + 1

    @property
    def rows(self) -> int:
        """Vertices along v."""
        return round(self.size_m[1] / self.resolution_m) + 1

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return self.rows * self.columns

    @cached_property
    def material_coordinates(self) -> NDArray[np.float64]:
        """(u, v) of each vertex [m], float64, shape [vertex_count, 2]."""
        v, u = np.meshgrid(
            np.arange(self.rows) * self.resolution_m, np.arange(self.columns) * self.resolution_m, indexing="ij"
        )
        return np.stack([u.ravel(), v.ravel()], axis=1)

    @cached_property
    def triangles(self) -> NDArray[np.int32]:
        """Two triangles a cell, see :func:`grid_triangles`."""
        return grid_triangles(self.rows, self.columns)

    @cached_property
    def uv(self) -> NDArray[np.float64]:
        """Texture coordinates in [0, 1], shape [vertex_count, 2]."""
        return np.asarray(self.material_coordinates / np.asarray(self.size_m), dtype=np.float64)


def grid_triangles(rows: int, columns: int) -> NDArray[np.int32]:
    """Two triangles a cell, alternating diagonals, counter-clockwise seen from +z; int32, shape [2 * cells, 3]."""
    j, i = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (j * columns + i).ravel()  # top left
    b, c, d = a + 1, a + columns, a + columns + 1  # top right, bottom left, bottom right
    even = ((i + j) % 2 == 0).ravel()
    first = np.where(even[:, None], np.stack([a, c, d], 1), np.stack([a, c, b], 1))
    second = np.where(even[:, None], np.stack([a, d, b], 1), np.stack([b, c, d], 1))
    return np.concatenate([first, second]).astype(np.int32)
