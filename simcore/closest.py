"""Closest points of vertices and triangles, and of edges (Ericson 2005, chapter 5), many at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("nc,nc->n", a, b))


def _share(part: Array, whole: Array) -> Array:
    return np.asarray(np.divide(part, whole, out=np.zeros_like(part), where=np.abs(whole) > 1e-300))


def on_triangles(points: Array, corners: Array) -> Array:
    """Barycentric coordinates of the point of each triangle that is closest to its point.

    Args:
        points: [N, 3].
        corners: [N, 3 corners, 3].

    Returns:
        [N, 3], not negative, adding up to one.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac = b - a, c - a
    d1, d2 = _dot(ab, points - a), _dot(ac, points - a)
    d3, d4 = _dot(ab, points - b), _dot(ac, points - b)
    d5, d6 = _dot(ab, points - c), _dot(ac, points - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    on_ab, on_ac = _share(d1, d1 - d3), _share(d2, d2 - d6)
    on_bc = _share(d4 - d3, (d4 - d3) + (d5 - d6))
    total = va + vb + vc
    v, w = _share(vb, total), _share(vc, total)
    zero, one = np.zeros_like(d1), np.ones_like(d1)
    regions = [
        (d1 <= 0) & (d2 <= 0),
        (d3 >= 0) & (d4 <= d3),
        (d6 >= 0) & (d5 <= d6),
        (vc <= 0) & (d1 >= 0) & (d3 <= 0),
        (vb <= 0) & (d2 >= 0) & (d6 <= 0),
        (va <= 0) & (d4 - d3 >= 0) & (d5 - d6 >= 0),
    ]
    second = np.select(regions, [zero, one, zero, on_ab, zero, 1.0 - on_bc], v)
    third = np.select(regions, [zero, zero, one, zero, on_ac, on_bc], w)
    return np.stack([1.0 - second - third, second, third], axis=1)


def on_edges(first: Array, second: Array) -> tuple[Array, Array]:
    """Where along two edges they are closest, each in [0, 1]; arrays [N, 2 ends, 3]."""
    d1, d2, r = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0], first[:, 0] - second[:, 0]
    a, e, b = _dot(d1, d1), _dot(d2, d2), _dot(d1, d2)
    c, f = _dot(d1, r), _dot(d2, r)
    s = np.clip(_share(b * f - c * e, a * e - b * b), 0.0, 1.0)
    t = _share(b * s + f, e)
    s = np.where(t < 0.0, np.clip(_share(-c, a), 0.0, 1.0), np.where(t > 1.0, np.clip(_share(b - c, a), 0.0, 1.0), s))
    return s, np.clip(t, 0.0, 1.0)
