"""Sheets of which each point is seen on its own cannot pass through themselves."""

from __future__ import annotations

import numpy as np
import pytest

from simcore import crossings
from simcore.crossings import count_crossings
from simcore.height_field import is_height_field
from simcore.mesh import GridMesh

MESH = GridMesh(0.02, (0.2, 0.3))


def sheet(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.stack(np.broadcast_arrays(x, y, z), axis=1).astype(float)


def test_a_wavy_sheet_is_one_seen_from_either_side() -> None:
    u, v = MESH.material_coordinates.T
    wavy = sheet(u + 0.003 * np.sin(40 * v), -v, 0.02 * np.sin(30 * u))
    assert is_height_field(wavy, MESH.triangles)
    assert is_height_field(wavy * [-1.0, 1.0, 1.0], MESH.triangles)


def test_a_sheet_that_hides_a_part_of_itself_is_none() -> None:
    u, v = MESH.material_coordinates.T
    rolled = sheet(np.sin(15 * u) / 15, -v, np.cos(15 * u) / 15)
    assert not is_height_field(rolled, MESH.triangles)
    folded = np.where(u < 0.1, u, 0.2 - u)
    assert not is_height_field(sheet(folded, -v, 0.01 * (u > 0.1)), MESH.triangles)


def test_a_strip_that_winds_over_itself_is_none_although_all_of_it_is_seen_from_one_side() -> None:
    """As a spiral ramp: every triangle faces the front, and the ends lie above each other."""
    u, v = MESH.material_coordinates.T
    angle = 2.4 * np.pi * v / v.max()
    ramp = sheet((0.1 + u) * np.cos(angle), (0.1 + u) * np.sin(angle), 0.05 * angle)
    turns = ramp[MESH.triangles][:, :, :2]
    sides = turns[:, 1:] - turns[:, :1]
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    assert (area > 0).all() or (area < 0).all()
    assert not is_height_field(ramp, MESH.triangles)
    assert count_crossings(ramp, MESH.triangles) == 0
    through = ramp * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.001] * np.sin(900 * u)[:, None]
    assert count_crossings(through, MESH.triangles) > 0


def test_what_is_no_disc_is_none() -> None:
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [3, 0, 0], [4, 0, 0], [3, 1, 0]], dtype=float)
    two = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)
    assert is_height_field(flat[:3], two[:1]) and not is_height_field(flat, two)
    ring = np.array([[0, 3, 1], [1, 3, 4], [1, 4, 2], [2, 4, 5], [2, 5, 0], [0, 5, 3]], dtype=np.int32)
    round_ = np.array([[np.cos(a), np.sin(a), 0] for a in (0.0, 2.1, 4.2)])
    assert not is_height_field(np.concatenate([round_, 2 * round_]), ring)


@pytest.mark.parametrize("rough_m", [0.001, 0.004, 0.012])
def test_what_is_called_one_crosses_itself_nowhere(rough_m: float, monkeypatch: pytest.MonkeyPatch) -> None:
    u, v = MESH.material_coordinates.T
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        rough = sheet(u, -v, 0.0 * u) + rough_m * rng.standard_normal((len(u), 3)) * [1.0, 1.0, 5.0]
        found.append(is_height_field(rough, MESH.triangles))
        monkeypatch.setattr(crossings, "is_height_field", lambda *given: False)
        crossing = count_crossings(rough, MESH.triangles)
        monkeypatch.undo()
        assert not (found[-1] and crossing) and count_crossings(rough, MESH.triangles) == crossing
    assert any(found) == (rough_m < 0.01) and all(found) == (rough_m < 0.002)
