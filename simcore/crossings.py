"""Where a cloth passes through itself: edges of the mesh that pierce its triangles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from simcore.height_field import is_height_field

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
_CHUNK = 200_000
"""Pairs that are looked at together: what is made of them takes some hundred bytes each."""


@dataclass(frozen=True)
class _Sides:
    """A triangle mesh with its edges.

    Attributes:
        corners: first, second and third vertex of each triangle, int64, shape [3, triangles].
        edges: vertices of each edge, the smaller number first, int32, shape [edges, 2].
        opposite: the edge opposite each of those corners, int64, shape [3, triangles].
        own: that edge is counted with this triangle, not with the other one at it, bool, shape [3, triangles].
    """

    corners: Ints
    edges: NDArray[np.int32]
    opposite: Ints
    own: NDArray[np.bool_]

    @classmethod
    def of(cls, triangles: NDArray[np.int32]) -> _Sides:
        """Sort out the edges of triangles, int32, shape [triangles, 3]."""
        sides = np.concatenate([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]])
        sides = np.sort(sides, axis=1).astype(np.int64)
        count = int(sides.max(initial=0)) + 1
        # numbers sort faster than pairs
        keys, first, number = np.unique(sides[:, 0] * count + sides[:, 1], return_index=True, return_inverse=True)
        own = np.zeros(len(sides), dtype=bool)
        own[first] = True
        edges = np.stack([keys // count, keys % count], axis=1).astype(np.int32)
        corners = np.ascontiguousarray(triangles.T, dtype=np.int64)
        return cls(corners, edges, number.reshape(3, -1), own.reshape(3, -1))

    def apart(self, one: Ints, two: Ints) -> Iterator[tuple[Ints, Ints]]:
        """Of pairs of triangles, pairs of an edge of one of them and the other, where they have no common vertex."""
        ours, theirs = [c.take(one) for c in self.corners], [c.take(two) for c in self.corners]
        same = np.array([[a == b for b in theirs] for a in ours])
        for triangle, other, axis in ((one, two, 1), (two, one, 0)):
            common = np.asarray(same.any(axis=axis))
            for k in range(3):
                free = np.flatnonzero(self.own[k].take(triangle) & ~(common[k - 1] | common[k - 2]))
                yield self.opposite[k].take(triangle.take(free)), other.take(free)


@lru_cache(maxsize=4)
def _sides(triangles: bytes) -> _Sides:
    """Kept from drape to drape of a mesh."""
    return _Sides.of(np.frombuffer(triangles, dtype=np.int32).reshape(-1, 3))


class _Boxes:
    """Smallest boxes round some points each; points of shape [N, 3], one array for each of a box's points."""

    def __init__(self, *points: Array) -> None:
        low, high = points[0], points[0]
        for point in points[1:]:
            low, high = np.minimum(low, point), np.maximum(high, point)
        self.middle = 0.5 * (low + high)
        self.largest = float((high - low).max(initial=0.0))
        self._low, self._high = np.ascontiguousarray(low.T), np.ascontiguousarray(high.T)

    def meeting(self, mine: Ints, others: _Boxes, theirs: Ints) -> tuple[Ints, Ints]:
        """Those of pairs of boxes that have a common point."""
        for axis in range(3):
            reach = self._high[axis].take(mine) >= others._low[axis].take(theirs)
            reach &= others._high[axis].take(theirs) >= self._low[axis].take(mine)
            mine, theirs = mine[reach], theirs[reach]
        return mine, theirs


def edges_of(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """Each edge of a triangle mesh once, int32, shape [edges, 2]."""
    return _Sides.of(triangles).edges


def count_crossings(vertices: Array, triangles: NDArray[np.int32]) -> int:
    """Number of (edge, triangle) pairs without a common vertex that cross.

    Args:
        vertices: positions [m], shape [V, 3].
        triangles: vertex indices, shape [T, 3].
    """
    if is_height_field(vertices, triangles):
        return 0
    sides = _sides(np.ascontiguousarray(triangles, dtype=np.int32).tobytes())
    corners, ends = vertices[triangles], vertices[sides.edges]
    whole, narrow = _Boxes(*corners.transpose(1, 0, 2)), _Boxes(*ends.transpose(1, 0, 2))
    reach = (1.0 + 1e-9) * whole.largest  # boxes that meet have their middles no farther apart along any axis
    near = cKDTree(whole.middle).query_pairs(reach, p=np.inf, output_type="ndarray")
    count = 0
    for k in range(0, len(near), _CHUNK):
        one, two = (np.ascontiguousarray(some) for some in near[k : k + _CHUNK].T)
        for edge, triangle in sides.apart(*whole.meeting(one, whole, two)):
            edge, triangle = narrow.meeting(edge, whole, triangle)
            count += int(pierces(ends[edge], corners[triangle]).sum())
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
