"""Irregular triangles for the other simulator of cloth, and what one mesh's drape says on another."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CloughTocher2DInterpolator, NearestNDInterpolator
from scipy.spatial import Delaunay

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Mesh:
    """An irregular triangulation of a flat sample.

    Attributes:
        uv: material coordinates [m], u along weft, v along warp and downwards, [vertices, 2].
        triangles: [triangles, 3].
        edges: inner edges with the vertices opposite: (end, end, opposite, opposite), [hinges, 4].
    """

    uv: Array
    triangles: Ints
    edges: Ints

    @classmethod
    def of(cls, size_m: tuple[float, float], cell_m: float, seed: int) -> Mesh:
        """Rows of a hexagonal lattice, shaken; corners and edges are kept."""
        rng = np.random.default_rng(seed)
        width, height = size_m
        across, down = round(width / cell_m), round(height / cell_m)
        u, v = np.linspace(0, width, across + 1), np.linspace(0, height, down + 1)
        rim = [(a, b) for a in u for b in (0.0, height)] + [(a, b) for a in (0.0, width) for b in v[1:-1]]
        inner = []
        for row, b in enumerate(np.arange(0.8 * cell_m, height - 0.6 * cell_m, cell_m * math.sqrt(3) / 2)):
            start = (0.75 + 0.5 * (row % 2)) * cell_m
            inner += [(a, b) for a in np.arange(start, width - 0.6 * cell_m, cell_m)]
        shaken = np.array(inner) + rng.uniform(-0.18, 0.18, (len(inner), 2)) * cell_m
        uv = np.concatenate([np.array(rim), shaken])
        triangles = Delaunay(uv).simplices.astype(np.int64)
        a, b, c = (uv[triangles[:, k]] for k in range(3))
        area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        triangles[area < 0] = triangles[area < 0][:, [0, 2, 1]]
        triangles = triangles[np.abs(area) > 0.02 * cell_m**2]
        return cls(uv, triangles, _hinges(triangles))


def _hinges(triangles: Ints) -> Ints:
    """Inner edges with the two vertices opposite, the first of the triangle in which the edge runs forward."""
    opposite: dict[tuple[int, int], int] = {}
    for a, b, c in triangles.tolist():
        opposite |= {(a, b): c, (b, c): a, (c, a): b}
    return np.array([(a, b, opposite[a, b], opposite[b, a]) for a, b in opposite if a < b and (b, a) in opposite])


def carried(vertices: Array, coarse: Mesh, fine: Mesh) -> Array:
    """Positions [vertices, 3] of one mesh where the vertices of another lie on the sample."""
    smooth = CloughTocher2DInterpolator(coarse.uv, vertices)(fine.uv)
    nearest = NearestNDInterpolator(coarse.uv, vertices)(fine.uv)
    return np.where(np.isfinite(smooth), smooth, nearest)  # on the sample's rim rounding decides
