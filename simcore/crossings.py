"""Where a cloth passes through itself: edges of the mesh that pierce its triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
_CHUNK = 40_000
"""Pairs that are looked at together: their corners and products take some hundred bytes each."""


def edges_of(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """Each edge of a triangle mesh once, int32, shape [edges, 2]."""
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    sides = np.sort(sides, axis=1).astype(np.int64)
    count = int(sides.max(initial=0)) + 1
    keys = np.unique(sides[:, 0] * count + sides[:, 1])  # numbers sort faster than pairs
    return np.stack([keys // count, keys % count], axis=1).astype(np.int32)


def count_crossings(vertices: Array, triangles: NDArray[np.int32]) -> int:
    """Number of (edge, triangle) pairs without a common vertex that cross.

    Args:
        vertices: positions [m], shape [V, 3].
        triangles: vertex indices, shape [T, 3].
    """
    edges = edges_of(triangles)
    corners = vertices[triangles]
    centres, middles = corners.mean(axis=1), vertices[edges].mean(axis=1)
    reach = float(np.linalg.norm(corners - centres[:, None], axis=2).max())
    reach += 0.5 * float(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1).max())
    near = cKDTree(middles).sparse_distance_matrix(cKDTree(centres), reach, output_type="ndarray")
    count = 0
    for k in range(0, len(near), _CHUNK):
        edge, triangle = near["i"][k : k + _CHUNK], near["j"][k : k + _CHUNK]
        apart = np.ones(len(edge), dtype=bool)
        for end in range(2):
            for corner in range(3):
                apart &= edges[edge, end] != triangles[triangle, corner]
        count += int(pierces(vertices[edges[edge[apart]]], corners[triangle[apart]]).sum())
    return count


def pierces(segments: Array, corners: Array) -> NDArray[np.bool_]:
    """Whether segment and triangle of a pair cross (Möller and Trumbore 1997); shapes [N, 2, 3] and [N, 3, 3]."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(along, e2)
    det = np.einsum("nc,nc->n", e1, p)
    safe = np.where(np.abs(det) > 1e-30, det, np.inf)
    to_start = start - corners[:, 0]
    u = np.einsum("nc,nc->n", to_start, p) / safe
    q = np.cross(to_start, e1)
    v = np.einsum("nc,nc->n", along, q) / safe
    t = np.einsum("nc,nc->n", e2, q) / safe
    inside = (u > 0.0) & (v > 0.0) & (u + v < 1.0) & (t > 0.0) & (t < 1.0)
    return np.asarray(inside & (np.abs(det) > 1e-30))
