"""The regular grid that stands for the sample."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError
from simcore.number import are_finite, check_finite, shown

LEAST_CELL_M, LARGEST_CELL_M = 1e-3, 0.1
FEWEST_CELLS = 4
"""Along either edge."""
MOST_VERTICES = 300_000
"""Half a metre in cells of 1 mm has 251,001. What a drape takes of time and memory grows faster than their number."""


@dataclass(frozen=True)
class GridMesh:
    """A rectangular sample cut into square cells.

    Vertex ``(j, i)`` of ``rows x columns`` has material coordinates ``u = i * resolution`` from the left edge along
    weft and ``v = j * resolution`` from the top edge along warp, both [m]; its flat index is ``j * columns + i``.

    Attributes:
        resolution_m: edge of a cell [m].
        size_m: width (u) and height (v) [m].

    Raises:
        InputError: the resolution does not divide the sample, gives more than :data:`MOST_VERTICES`, or is absurd.
    """

    resolution_m: float
    size_m: tuple[float, float] = (0.5, 0.5)

    def __post_init__(self) -> None:
        h = self.resolution_m
        check_finite("resolution, the edge of a cell [m],", h, "resolution_out_of_range")
        if not LEAST_CELL_M <= h <= LARGEST_CELL_M:
            raise InputError(
                f"resolution {h} m must be from {LEAST_CELL_M} to {LARGEST_CELL_M} m", code="resolution_out_of_range"
            )
        if not are_finite(self.size_m, 2) or min(self.size_m) <= 0.0:
            raise InputError(
                f"the sample size {shown(self.size_m)} m needs a positive width and height", code="sample_size"
            )
        if (vertices := _vertices(h, self.size_m)) > MOST_VERTICES:
            nearest = _nearest_cell_m(h, self.size_m)
            advice = f"try {nearest:.9g}" if nearest is not None else "no cell that divides it gives so few: cut it up"
            raise InputError(
                f"resolution {h} m on a sample of {self.size_m[0]:g} x {self.size_m[1]:g} m gives {vertices:.3g} "
                f"vertices, more than {MOST_VERTICES:,}: {advice}",
                code="mesh_too_large",
            )
        for length in self.size_m:
            if not _divides(h, length):
                nearest = _nearest_cell_m(h, self.size_m)
                advice = (
                    f"try {nearest:.9g}"
                    if nearest is not None
                    else "no cell of 1 to 100 mm divides both of its sides: give them to a millimetre or two"
                )
                raise InputError(
                    f"resolution {h} m does not divide the sample's {length} m into at least {FEWEST_CELLS} whole "
                    f"cells: {advice}",
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


def _divides(cell_m: float, length_m: float) -> bool:
    """Into whole cells, not too few."""
    cells = length_m / cell_m
    return abs(cells - round(cells)) <= 1e-6 and round(cells) >= FEWEST_CELLS


def _vertices(cell_m: float, size_m: tuple[float, float]) -> float:
    """How many vertices such cells have, whole or not."""
    return (size_m[0] / cell_m + 1.0) * (size_m[1] / cell_m + 1.0)


def _nearest_cell_m(cell_m: float, size_m: tuple[float, float]) -> float | None:
    """The cell nearest in proportion that divides both sides and does not give too many vertices; None where none
    does."""
    short = min(size_m)
    fewest = max(FEWEST_CELLS, math.ceil(min(short / LARGEST_CELL_M, MOST_VERTICES)))
    most = math.floor(min(short / LEAST_CELL_M, math.sqrt(MOST_VERTICES)))
    cells = (short / n for n in range(fewest, most + 1))
    few = (c for c in cells if _vertices(c, size_m) <= MOST_VERTICES)
    fit = [c for c in few if all(_divides(c, length) for length in size_m)]
    return min(fit, key=lambda c: abs(math.log(c / cell_m)), default=None)


def grid_triangles(rows: int, columns: int) -> NDArray[np.int32]:
    """Two triangles a cell, alternating diagonals, counter-clockwise seen from +z; int32, shape [2 * cells, 3]."""
    j, i = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (j * columns + i).ravel()  # top left
    b, c, d = a + 1, a + columns, a + columns + 1  # top right, bottom left, bottom right
    even = ((i + j) % 2 == 0).ravel()
    first = np.where(even[:, None], np.stack([a, c, d], 1), np.stack([a, c, b], 1))
    second = np.where(even[:, None], np.stack([a, d, b], 1), np.stack([b, c, d], 1))
    return np.concatenate([first, second]).astype(np.int32)
