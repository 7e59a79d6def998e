"""The judge of cloth that passes through itself."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.crossings import count_crossings, edges_of
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
