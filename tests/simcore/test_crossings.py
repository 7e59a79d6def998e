"""The judge of cloth that passes through itself."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.crossings import count_crossings, edges_of, pierces
from simcore.mesh import GridMesh

MESH = GridMesh(0.02, (0.2, 0.3))


def flap(gap: float) -> np.ndarray:
    """A sheet folded over itself along a vertical line, the flap ``gap`` in front; negative: through it."""
    u, v = MESH.material_coordinates.T
    turn = 0.01
    x = np.where(u < 0.1, u, np.where(u < 0.1 + np.pi * turn, 0.1 + turn * np.sin((u - 0.1) / turn), 0.2 - u))
    z = np.where(u < 0.1, 0.0, np.where(u < 0.1 + np.pi * turn, turn * (1 - np.cos((u - 0.1) / turn)), 2 * turn))
    z = np.where(u > 0.16, gap, z)
    return np.stack([x, -v, z], axis=1)


def test_flat_rolled_and_folded_sheets_do_not_cross() -> None:
    u, v = MESH.material_coordinates.T
    assert count_crossings(np.stack([u, -v, 0 * u], axis=1), MESH.triangles) == 0
    assert count_crossings(np.stack([np.sin(15 * u) / 15, -v, np.cos(15 * u) / 15], axis=1), MESH.triangles) == 0
    assert count_crossings(flap(0.002), MESH.triangles) == 0


def test_a_flap_pushed_through_is_counted() -> None:
    assert count_crossings(flap(-0.002), MESH.triangles) > 10


@pytest.mark.parametrize("shift", [0.0013, 0.0047])
def test_one_triangle_through_another(shift: float) -> None:
    vertices = np.array(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2 + shift, 0.2, -0.5], [0.3, 0.3, 0.5], [0.2, 3.0, 0.5]], dtype=float
    )
    triangles = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)
    assert count_crossings(vertices, triangles) == 2
    vertices[3:, 2] += 2.0
    assert count_crossings(vertices, triangles) == 0


def test_each_edge_once() -> None:
    edges = edges_of(MESH.triangles)
    rows, columns = MESH.rows, MESH.columns
    assert len(edges) == rows * (columns - 1) + columns * (rows - 1) + (rows - 1) * (columns - 1)


def counted_one_by_one(vertices: np.ndarray, triangles: np.ndarray) -> int:
    """Every edge against every triangle that has no vertex of it."""
    edges = edges_of(triangles)
    edge, triangle = (k.ravel() for k in np.indices((len(edges), len(triangles))))
    apart = (edges[edge][:, :, None] != triangles[triangle][:, None, :]).all(axis=(1, 2))
    return int(pierces(vertices[edges[edge[apart]]], vertices[triangles[triangle[apart]]]).sum())


@pytest.mark.parametrize("rough_m", [0.002, 0.01, 0.03, 0.1])
@pytest.mark.parametrize("seed", range(3))
def test_none_is_overlooked_in_a_crumpled_sheet(rough_m: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for size_m in ((0.08, 0.2), (0.16, 0.1)):
        mesh = GridMesh(0.02, size_m)
        u, v = mesh.material_coordinates.T
        vertices = np.stack([u, -v, 0.0 * u], axis=1) + rough_m * rng.standard_normal((len(u), 3))
        expected = counted_one_by_one(vertices, mesh.triangles)
        assert count_crossings(vertices, mesh.triangles) == expected
        assert rough_m < 0.01 or expected > 0


def test_many_pairs_are_counted_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices = flap(-0.002)
    whole = count_crossings(vertices, MESH.triangles)
    monkeypatch.setattr("simcore.crossings._CHUNK", 7)
    assert count_crossings(vertices, MESH.triangles) == whole > 10


def test_an_even_sheet_crosses_nothing_however_it_is_turned() -> None:
    u, v = MESH.material_coordinates.T
    for seed in range(20):
        turn, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
        assert count_crossings(np.stack([u, -v, 0.0 * u], axis=1) @ turn.T, MESH.triangles) == 0
