"""Contact of the cloth with itself in plain NumPy, written from ``docs/conventions.md`` alone.

Apart from the solver on purpose: every pair of parts is looked at, closest points are the nearest of all candidates
(the common perpendicular, or the foot on a side) instead of Ericson's regions, crossings are told by signs of volumes,
and the triangles are its own. Positions may be complex: choices are made by their real parts, so that a complex step
goes through.

Positions: float64 (or complex128) [rows, columns, 3], metres, panel frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

Array = NDArray[Any]

REACH_M = 2e-3
REACH_CELLS = 0.2
WEIGHTS = 5.0
CELLS_APART = 2
CHUNK = 300
"""First parts of the pairs that are looked at together."""


@dataclass(frozen=True)
class Contacts:
    """Pairs within reach: vertices int [pairs, 4], weights [pairs, 4] that sum up to ``between`` [pairs, 3] [m]."""

    vertices: Array
    weights: Array
    between: Array


def dot(a: Array, b: Array) -> Array:
    """Without conjugation."""
    return np.sum(a * b, axis=-1)


def length(a: Array) -> Array:
    """Square root of the sum of squares, analytic."""
    return np.sqrt(dot(a, a))


@cache
def parts(rows: int, columns: int) -> tuple[Array, Array]:
    """(triangles [n, 3], their sides [m, 2]): cells with j + i even are cut from their top left corner, others not."""
    triangles: list[tuple[int, int, int]] = []
    for j in range(rows - 1):
        for i in range(columns - 1):
            here, right, below, across = (
                (j + dj) * columns + i + di for dj, di in ((0, 0), (0, 1), (1, 0), (1, 1))
            )  # fmt: skip
            if (j + i) % 2 == 0:
                triangles += [(here, across, right), (here, across, below)]
            else:
                triangles += [(right, below, here), (right, below, across)]
    sides = {tuple(sorted((t[a], t[b]))) for t in triangles for a, b in ((0, 1), (1, 2), (0, 2))}
    return np.array(triangles), np.array(sorted(sides))


def apart(first: Array, second: Array, columns: int, cells: int) -> Array:
    """Whether all vertices of the one are some rows or columns from all of the other; [n, p] and [n, q] to [n]."""
    a, b = first[:, :, None], second[:, None, :]
    steps = np.maximum(np.abs(a // columns - b // columns), np.abs(a % columns - b % columns))
    return np.all(steps >= cells, axis=(1, 2))


def near_pairs(first: Array, second: Array, corners: Array, reach: float, columns: int, cells: int) -> Array:
    """All pairs of parts that are apart on the sample and whose spheres are within reach; int [n, 2]."""
    middles, radii = [], []
    for part in (first, second):
        places = corners[part]
        middles.append(places.mean(axis=1))
        radii.append(np.linalg.norm(places - middles[-1][:, None], axis=2).max(axis=1))
    found = []
    for k in range(0, len(first), CHUNK):
        gaps = np.linalg.norm(middles[0][k : k + CHUNK, None] - middles[1][None], axis=2)
        one, two = np.nonzero(gaps < radii[0][k : k + CHUNK, None] + radii[1][None] + reach)
        keep = apart(first[one + k], second[two], columns, cells)
        found.append(np.stack([one[keep] + k, two[keep]], axis=1))
    return np.concatenate(found)


def foot(point: Array, start: Array, end: Array) -> Array:
    """Where along a segment it is closest to a point, in [0, 1]; [n]."""
    along = end - start
    share = dot(point - start, along) / dot(along, along)
    return np.where(share.real < 0.0, 0.0, np.where(share.real > 1.0, 1.0, share))


def choose(candidates: list[tuple[Array, Array]], places: Array) -> Array:
    """Of candidates (allowed [n], weights [n, 4]) the allowed one with the least distance, as weights [n, 4]."""
    best, least = np.zeros_like(candidates[0][1]), np.full(len(places), np.inf)
    for allowed, weights in candidates:
        distance = length(np.sum(weights[..., None] * places, axis=1)).real
        nearer = allowed & (distance < least)
        best[nearer], least[nearer] = weights[nearer], distance[nearer]
    return best


def point_and_triangle(places: Array) -> Array:
    """Weights [n, 4] of the point and the corners, [n, 4, 3], that make the shortest vector between them."""
    p, a, b, c = (places[:, k] for k in range(4))
    u, v, w = b - a, c - a, p - a
    uu, uv, vv, wu, wv = dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v)
    by_b = (vv * wu - uv * wv) / (uu * vv - uv * uv)
    by_c = (uu * wv - uv * wu) / (uu * vv - uv * uv)
    one = np.ones_like(by_b)
    inside = (by_b.real >= 0.0) & (by_c.real >= 0.0) & (by_b.real + by_c.real <= 1.0)
    candidates = [(inside, np.stack([one, by_b + by_c - 1.0, -by_b, -by_c], axis=1))]
    for k, m in ((1, 2), (2, 3), (3, 1)):
        share = foot(p, places[:, k], places[:, m])
        weights = np.zeros((len(p), 4), dtype=places.dtype)
        weights[:, 0], weights[:, k], weights[:, m] = 1.0, share - 1.0, -share
        candidates.append((inside | True, weights))
    return choose(candidates, places)


def two_edges(places: Array) -> Array:
    """Weights [n, 4] of the ends of two edges, [n, 4, 3], that make the shortest vector between them."""
    a, b, c, d = (places[:, k] for k in range(4))
    u, v, w = b - a, d - c, a - c
    uu, uv, vv, wu, wv = dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v)
    size = uu * vv - uv * uv
    crossing = size.real > 1e-12 * (uu * vv).real
    size = np.where(crossing, size, 1.0)
    s, t = (uv * wv - vv * wu) / size, (uu * wv - uv * wu) / size
    inside = crossing & (s.real >= 0.0) & (s.real <= 1.0) & (t.real >= 0.0) & (t.real <= 1.0)
    candidates = [(inside, np.stack([1.0 - s, s, t - 1.0, -t], axis=1))]
    for end, one, two in ((0, 2, 3), (1, 2, 3), (2, 0, 1), (3, 0, 1)):
        share = foot(places[:, end], places[:, one], places[:, two])
        sign = 1.0 if end < 2 else -1.0
        weights = np.zeros((len(a), 4), dtype=places.dtype)
        weights[:, end], weights[:, one], weights[:, two] = sign, sign * (share - 1.0), -sign * share
        candidates.append((inside | True, weights))
    return choose(candidates, places)


def volume(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Six times the signed volume of tetrahedra."""
    return dot(np.cross(b - a, c - a), d - a)


def pierced(points: Array, rows: int, columns: int, cells: int) -> bool:
    """Whether a side pierces a triangle some cells from it; points real [rows * columns, 3]."""
    triangles, sides = parts(rows, columns)
    pairs = near_pairs(sides, triangles, points, 0.0, columns, cells)
    p, q = (points[sides[pairs[:, 0], k]] for k in range(2))
    a, b, c = (points[triangles[pairs[:, 1], k]] for k in range(3))
    either_side = volume(a, b, c, p) * volume(a, b, c, q) < 0.0
    turns = np.sign([volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)])
    return bool(np.any(either_side & (np.abs(turns.sum(axis=0)) == 3.0)))


def members_near(points: Array, rows: int, columns: int, reach: float, cells: int) -> tuple[Array, Array]:
    """Vertices of all pairs that may be within reach, (vertex and triangle [n, 4], edge and edge [m, 4])."""
    triangles, sides = parts(rows, columns)
    vertices = np.arange(len(points))[:, None]
    corner = near_pairs(vertices, triangles, points, reach, columns, cells)
    edge = near_pairs(sides, sides, points, reach, columns, cells)
    edge = edge[edge[:, 0] < edge[:, 1]]
    return (
        np.concatenate([vertices[corner[:, 0]], triangles[corner[:, 1]]], axis=1),
        np.concatenate([sides[edge[:, 0]], sides[edge[:, 1]]], axis=1),
    )


def contacts(x: Array, reach: float, among: tuple[Array, Array] | None = None, cells: int = CELLS_APART) -> Contacts:
    """All pairs within reach; ``among``: those of :func:`members_near` where they are known."""
    rows, columns, _ = x.shape
    points = x.reshape(-1, 3)
    corner, edge = among or members_near(points.real, rows, columns, reach, cells)
    members = np.concatenate([corner, edge])
    weights = np.concatenate([point_and_triangle(points[corner]), two_edges(points[edge])])
    between = np.sum(weights[..., None] * points[members], axis=1)
    near = length(between).real < reach
    return Contacts(members[near], weights[near], between[near])


def measures(hu: float, hv: float, weight: float) -> tuple[float, float]:
    """(reach [m], energy scale [J]) of cells of hu x hv [m] whose inner vertices weigh ``weight`` [N]."""
    reach = min(REACH_M, REACH_CELLS * min(hu, hv))
    return reach, WEIGHTS * weight * reach


def own_contact_energy(x: Array, hu: float, hv: float, weight: float, cells: int = CELLS_APART) -> Any:
    """[J]; infinite where the cloth crosses itself."""
    rows, columns, _ = x.shape
    if pierced(x.reshape(-1, 3).real, rows, columns, cells):
        return math.inf
    reach, scale = measures(hu, hv, weight)
    t = length(contacts(x, reach, cells=cells).between) / reach
    return -scale * np.sum((t - 1.0) ** 2 * np.log(t))


def own_contact_gradient(
    x: Array,
    hu: float,
    hv: float,
    weight: float,
    among: tuple[Array, Array] | None = None,
    cells: int = CELLS_APART,
) -> Array:
    """[N], of held vertices too. Weights need no derivative: a shortest distance is stationary in them."""
    reach, scale = measures(hu, hv, weight)
    found = contacts(x, reach, among, cells)
    distance = length(found.between)
    t = distance / reach
    slope = -scale / reach * (2.0 * (t - 1.0) * np.log(t) + (t - 1.0) ** 2 / t)
    g = np.zeros((x.shape[0] * x.shape[1], 3))
    for k in range(4):
        np.add.at(g, found.vertices[:, k], (slope * found.weights[:, k] / distance)[:, None] * found.between)
    return g.reshape(x.shape)


def own_contact_stiffness(x: Array, hu: float, hv: float, weight: float, cells: int = CELLS_APART) -> sp.csc_array:
    """Second derivatives by central differences of the gradient, turning normals and all [N/m], [3 V, 3 V]."""
    rows, columns, _ = x.shape
    step, (reach, _) = 1e-8, measures(hu, hv, weight)
    among = members_near(x.reshape(-1, 3), rows, columns, reach + 10.0 * step, cells)
    entries: list[tuple[Array, Array, Array]] = []
    for vertex in np.unique(contacts(x, reach + 10.0 * step, among).vertices):
        for column in range(3 * vertex, 3 * vertex + 3):
            d = np.zeros(x.size)
            d[column] = step
            ahead, behind = (
                own_contact_gradient(x + sign * d.reshape(x.shape), hu, hv, weight, among).ravel()
                for sign in (1.0, -1.0)
            )
            row = np.flatnonzero(ahead - behind)
            entries.append((row, np.full(len(row), column), ((ahead - behind) / (2.0 * step))[row]))
    if not entries:
        return sp.csc_array((x.size, x.size))
    row, column, value = (np.concatenate([e[n] for e in entries]) for n in range(3))
    return sp.csc_array((value, (row, column)), shape=(x.size, x.size))
