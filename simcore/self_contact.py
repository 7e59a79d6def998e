"""Contact of the cloth with itself: a barrier between its vertices and triangles, and between its edges."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from simcore.closest import on_edges, on_triangles
from simcore.crossings import edges_of, pierces
from simcore.grid import Grid
from simcore.mesh import grid_triangles

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

REACH_M = 2e-3
"""Distance between two parts of the cloth at which they begin to push [m]; at most a fifth of a cell."""
STIFFNESS_WEIGHTS = 5.0
"""Barrier energy scale: this many vertex weights times the reach, as at the panel."""
APART, TUCKED = 2, 1
"""Cells between two parts from which on they count as parts of their own: as a rule, and where a tuck of two cells, as
round a point that the folds run into, would be left to cross."""
FOLD = 2
"""So many cells farther along the cloth, nearness in space means a fold."""
WIDER = 2
"""Cells round such vertices that are looked at, too."""
PART = 40_000
"""Pairs that are looked at together: where a cell is far stretched, a million lie within its length."""
SLACK_CELLS = 0.3
"""How far vertices may go before the pairs that can touch are looked up again [cells]."""


@dataclass(frozen=True)
class Pairs:
    """Pairs of parts that are near: four vertices each, signed weights that make the vector between them.

    Attributes:
        vertices: int, shape [pairs, 4].
        weights: shape [pairs, 4]; positive ones of the first part and negative ones of the second add up to zero.
        distance: [m], shape [pairs].
        normal: unit vector from the second part to the first, shape [pairs, 3].
    """

    vertices: Ints
    weights: Array
    distance: Array
    normal: Array


class SelfContact:
    """Barrier -s (t - 1)² ln t, t = distance / reach, over all near pairs; infinite where the cloth crosses itself.

    Made for one grid and one fabric. Pairs that can touch are looked up in space and kept until a vertex has moved
    ``SLACK_CELLS``. Incremental potential contact (Li et al. 2020), with the test for crossings in place of their
    continuous collision detection.

    Args:
        grid: the vertices.
        weight: of an inner vertex [N].
        fixed: held vertices, int32 [rows, columns].
        apart: cells between parts that keep off each other, :data:`APART` or :data:`TUCKED`.
    """

    def __init__(self, grid: Grid, weight: float, fixed: NDArray[np.int32], apart: int = APART) -> None:
        self.apart = apart
        cell = min(grid.hu, grid.hv)
        self.reach = min(REACH_M, 0.2 * cell)
        self._scale = STIFFNESS_WEIGHTS * weight * self.reach
        self._slack = SLACK_CELLS * cell
        self._triangles = grid_triangles(grid.rows, grid.columns).astype(np.int64)
        self._edges = edges_of(grid_triangles(grid.rows, grid.columns)).astype(np.int64)
        self._columns = grid.columns
        self._free = np.repeat(fixed.ravel() == 0, 3)
        self._at: Array | None = None
        self._touching: tuple[Ints, Ints, Ints] | None = None

    def energy(self, x: Array) -> float:
        """[J]; infinite where the cloth crosses itself."""
        points = x.reshape(-1, 3)
        _, _, piercing = self._candidates(points)
        for part in _parts(piercing):
            if pierces(points[self._edges[part[:, 0]]], points[self._triangles[part[:, 1]]]).any():
                return math.inf
        t = self._pairs(points).distance / self.reach
        return float(-self._scale * np.sum((t - 1.0) ** 2 * np.log(np.maximum(t, 1e-300))))

    def add_gradient(self, x: Array, gradient: Array) -> None:
        """Add the derivative to ``gradient`` [N], zero where held."""
        pairs = self._pairs(x.reshape(-1, 3))
        if not len(pairs.distance):
            return
        t = pairs.distance / self.reach
        slope = -self._scale * (2.0 * (t - 1.0) * np.log(t) + (t - 1.0) ** 2 / t) / self.reach
        forces = (slope[:, None] * pairs.weights)[..., None] * pairs.normal[:, None, :]
        total = np.zeros((x.size // 3, 3))
        np.add.at(total, pairs.vertices.ravel(), forces.reshape(-1, 3))
        gradient += (total.ravel() * self._free).reshape(x.shape)

    def hessian(self, x: Array) -> sp.csr_array | None:
        """Second derivative along the normals [N/m], positive semi-definite, [3 V, 3 V]; None where nothing touches.

        The turning of the normals is left out: it weakens a contact by its force over its distance at most.
        """
        pairs = self._pairs(x.reshape(-1, 3))
        if not len(pairs.distance):
            return None
        t = pairs.distance / self.reach
        stiff = -(2.0 * np.log(t) + 4.0 * (t - 1.0) / t - (t - 1.0) ** 2 / t**2) * self._scale / self.reach**2
        row = (pairs.weights[..., None] * pairs.normal[:, None, :]).reshape(-1, 12) * np.sqrt(stiff)[:, None]
        column = (3 * pairs.vertices[..., None] + np.arange(3)).reshape(-1, 12)
        row *= self._free[column]
        number = np.repeat(np.arange(len(row)), 12)
        factor = sp.csr_array((row.ravel(), (number, column.ravel())), shape=(len(row), x.size))
        return sp.csr_array(factor.T @ factor)

    def _pairs(self, points: Array) -> Pairs:
        """Pairs within reach."""
        corners, ends, _ = self._candidates(points)
        parts = []
        if len(corners):
            vertex, triangle = corners.T
            shares = on_triangles(points[vertex], points[self._triangles[triangle]])
            members = np.concatenate([vertex[:, None], self._triangles[triangle]], axis=1)
            parts.append((members, np.concatenate([np.ones((len(shares), 1)), -shares], axis=1)))
        if len(ends):
            one, two = self._edges[ends[:, 0]], self._edges[ends[:, 1]]
            s, t = on_edges(points[one], points[two])
            parts.append((np.concatenate([one, two], axis=1), np.stack([1.0 - s, s, t - 1.0, -t], axis=1)))
        if not parts:
            return Pairs(np.zeros((0, 4), dtype=np.int64), np.zeros((0, 4)), np.zeros(0), np.zeros((0, 3)))
        members = np.concatenate([p[0] for p in parts])
        weights = np.concatenate([p[1] for p in parts])
        between = np.einsum("nk,nkc->nc", weights, points[members])
        distance = np.linalg.norm(between, axis=1)
        near = distance < self.reach
        distance = np.maximum(distance[near], 1e-12)
        return Pairs(members[near], weights[near], distance, between[near] / distance[:, None])

    def _candidates(self, points: Array) -> tuple[Ints, Ints, Ints]:
        """(vertex, triangle), (edge, edge) and (edge, triangle) that can touch until vertices have moved the slack."""
        if self._at is None or self._touching is None or np.abs(points - self._at).max() > self._slack / math.sqrt(3.0):
            self._at = points.copy()
            self._touching = self._look_up(points)
        return self._touching

    def _look_up(self, points: Array) -> tuple[Ints, Ints, Ints]:
        """The search proper, among the parts that a fold brings near each other."""
        clear = self.reach + 2.0 * self._slack
        folded = self._folded(points, clear)
        if not folded.any():
            nothing = np.zeros((0, 2), dtype=np.int64)
            return nothing, nothing, nothing
        triangles = np.flatnonzero(folded[self._triangles].any(axis=1))
        edges = np.flatnonzero(folded[self._edges].any(axis=1))
        vertices = np.flatnonzero(folded)
        corner_pairs, edge_pairs, piercing = self._search(points, clear, vertices, edges, triangles)
        corner_pairs = np.stack([vertices[corner_pairs[:, 0]], triangles[corner_pairs[:, 1]]], axis=1)
        piercing = np.stack([edges[piercing[:, 0]], triangles[piercing[:, 1]]], axis=1)
        return corner_pairs, edges[edge_pairs], piercing

    def _folded(self, points: Array, clear: float) -> NDArray[np.bool_]:
        """Vertices with others near them in space that are far along the cloth, and their neighbours; [V]."""
        from scipy.ndimage import binary_dilation

        ends = points[self._edges]
        longest = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max())
        pairs = cKDTree(points).query_pairs(clear + longest, output_type="ndarray")
        rows, columns = pairs // self._columns, pairs % self._columns
        far = np.maximum(np.abs(rows[:, 0] - rows[:, 1]), np.abs(columns[:, 0] - columns[:, 1])) >= self.apart + FOLD
        found = np.zeros(len(points), dtype=bool)
        found[pairs[far].ravel()] = True
        grid = found.reshape(-1, self._columns)
        return np.asarray(binary_dilation(grid, np.ones((3, 3), dtype=bool), WIDER).ravel() if found.any() else found)

    def _search(
        self, points: Array, clear: float, chosen: Ints, edges: Ints, triangles: Ints
    ) -> tuple[Ints, Ints, Ints]:
        """Pairs among the chosen vertices, edges and triangles, by their place in those lists."""
        tris, sides = self._triangles[triangles], self._edges[edges]
        corners, ends = points[tris], points[sides]
        centres, middles = corners.mean(axis=1), ends.mean(axis=1)
        wide = float(np.linalg.norm(corners - centres[:, None], axis=2).max())
        long = 0.5 * float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max())
        of_triangles, of_edges = cKDTree(centres), cKDTree(middles)
        own = points[chosen]

        def between(pairs: Ints) -> Array:
            s, t = on_edges(ends[pairs[:, 0]], ends[pairs[:, 1]])
            gap = _along(ends[pairs[:, 0]], s) - _along(ends[pairs[:, 1]], t)
            return np.asarray(np.linalg.norm(gap, axis=1))

        corner_pairs = _kept(
            _near(cKDTree(own), of_triangles, wide + clear),
            lambda pairs: self._apart(pairs, chosen[:, None], tris),
            lambda pairs: _gaps(own, corners, pairs) < clear,
        )
        edge_pairs = _kept(
            of_edges.query_pairs(2.0 * long + clear, output_type="ndarray").astype(np.int64),
            lambda pairs: self._apart(pairs, sides, sides),
            lambda pairs: between(pairs) < clear,
        )
        piercing = _kept(
            _near(of_edges, of_triangles, long + wide + clear),
            lambda pairs: self._apart(pairs, sides, tris),
            lambda pairs: _gaps(middles, corners, pairs) < long + clear,
        )
        return corner_pairs, edge_pairs, piercing

    def _apart(self, pairs: Ints, first: Ints, second: Ints) -> NDArray[np.bool_]:
        """Whether every vertex of a part is ``apart`` cells from every vertex of the other one, [pairs]."""
        a, b = first[pairs[:, 0]], second[pairs[:, 1]]
        rows = np.abs(a[:, :, None] // self._columns - b[:, None, :] // self._columns)
        columns = np.abs(a[:, :, None] % self._columns - b[:, None, :] % self._columns)
        return np.asarray((np.maximum(rows, columns) >= self.apart).all(axis=(1, 2)))


def _parts(pairs: Ints) -> Iterator[Ints]:
    """The same in parts of no more than :data:`PART`."""
    for k in range(0, len(pairs), PART):
        yield pairs[k : k + PART]


def _kept(pairs: Ints, *tests: Callable[[Ints], NDArray[np.bool_]]) -> Ints:
    """Those pairs that pass all tests, one test after the other."""
    found = [pairs[:0]]
    for part in _parts(pairs):
        for test in tests:
            part = part[test(part)]
        found.append(part)
    return np.concatenate(found)


def _near(first: cKDTree, second: cKDTree, radius: float) -> Ints:
    found = first.sparse_distance_matrix(second, radius, output_type="ndarray")
    order = np.lexsort((found["j"], found["i"]))
    return np.stack([found["i"][order], found["j"][order]], axis=1).astype(np.int64)


def _along(ends: Array, share: Array) -> Array:
    return np.asarray(ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0]))


def _gaps(places: Array, corners: Array, pairs: Ints) -> Array:
    """Distance of a place from a triangle, for each pair [m]."""
    own, theirs = places[pairs[:, 0]], corners[pairs[:, 1]]
    closest = np.einsum("nk,nkc->nc", on_triangles(own, theirs), theirs)
    return np.asarray(np.linalg.norm(own - closest, axis=1))
