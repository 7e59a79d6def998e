"""Cloth that hides no part of itself from the front: it cannot pass through itself either."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
LEAST_SHARE = 1e-4
"""Of the mean area in the picture, below which a triangle counts as seen edge on."""


def is_height_field(vertices: Array, triangles: NDArray[np.int32]) -> bool:
    """Whether every point of a sheet is seen from the front, along z, on its own: then no two of them meet in space.

    That is so where all triangles are seen from the same side and the sheet's rim does not cross itself in the picture:
    a map of a disc whose every triangle keeps its sense has one sheet wherever its rim goes round once.

    Args:
        vertices: positions [m], shape [V, 3].
        triangles: vertex indices, shape [T, 3]. What is no disc of one piece is never called a height field.
    """
    rim = _rim(np.ascontiguousarray(triangles, dtype=np.int32).tobytes())
    if rim is None:
        return False
    seen = vertices[:, :2]
    a, b, c = (seen[triangles[:, k]] for k in range(3))
    area = _turn(a, b, c)
    least = LEAST_SHARE * float(np.abs(area).mean())
    if not (np.all(area > least) or np.all(area < -least)):
        return False
    return not _crosses_itself(seen[rim])


@lru_cache(maxsize=4)
def _rim(triangles: bytes) -> Ints | None:
    """Vertices round a disc in order, [rim]; None where the mesh is none. Kept from drape to drape of a mesh."""
    corners = np.frombuffer(triangles, dtype=np.int32).reshape(-1, 3).astype(np.int64)
    count = int(corners.max(initial=0)) + 1
    along = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    keys, backward = along[:, 0] * count + along[:, 1], along[:, 1] * count + along[:, 0]
    if len(np.unique(keys)) < len(keys):
        return None
    outside = along[~np.isin(keys, backward)]
    edges = (len(along) + len(outside)) // 2
    following = dict(outside.tolist())
    if not len(outside) or len(following) < len(outside) or len(np.unique(corners)) - edges + len(corners) != 1:
        return None
    ring = [int(outside[0, 0])]
    while (vertex := following.get(ring[-1])) is not None and vertex != ring[0] and len(ring) <= len(outside):
        ring.append(vertex)
    return np.array(ring) if len(ring) == len(outside) else None


def _crosses_itself(ring: Array) -> bool:
    """Whether sides of a closed polygon touch that have no common corner; corners of shape [N, 2]."""
    start, end = ring, np.roll(ring, -1, axis=0)
    low, high = np.minimum(start, end), np.maximum(start, end)
    meet = np.ones((len(ring), len(ring)), dtype=bool)
    for axis in range(2):
        meet &= low[:, None, axis] <= high[None, :, axis]
    one, two = np.nonzero(np.triu(meet & meet.T, 2))
    apart = (two + 1) % len(ring) != one
    one, two = one[apart], two[apart]
    across = _turn(start[one], end[one], start[two]) * _turn(start[one], end[one], end[two])
    back = _turn(start[two], end[two], start[one]) * _turn(start[two], end[two], end[one])
    return bool(((across <= 0.0) & (back <= 0.0)).any())


def _turn(a: Array, b: Array, c: Array) -> Array:
    """Twice the signed areas of triangles in the plane, corners of shape [N, 2]."""
    one, two = b - a, c - a
    return np.asarray(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
