"""Pictures stretched or sheared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import affine_transform

from diagnosis.measurement.features import measure
from diagnosis.measurement.reference import Reference
from diagnosis.simulation.warps import WARP, warp_responses, warped
from renderer.camera import CANONICAL_CAMERA

SIDE, CELL = 256, 32
CENTRE = np.array([127.5, 127.5])


def slope_picture() -> Reference:
    """A plane that comes nearer by 1 mm a pixel from left to right, in square cells."""
    rows, columns = np.indices((SIDE, SIDE))
    cell = (rows // CELL * (SIDE // CELL) + columns // CELL).astype(np.int32)
    count = int(cell.max()) + 1
    none = np.zeros((SIDE, SIDE), dtype=bool)
    depth = (1.0 - 0.001 * columns).astype(np.float32)
    return Reference(depth, cell, none, none, np.ones(count), np.zeros(count), np.zeros((count, 2)))


def test_a_stretched_plane_moves_most_at_its_sides() -> None:
    reference = slope_picture()
    along_rows, mixed, other, along_columns = warp_responses(reference, CANONICAL_CAMERA)[:4, : reference.count]
    centres = (np.arange(SIDE // CELL) + 0.5) * CELL - 0.5 - CENTRE[1]
    inner = slice(1, -1)
    shape = along_columns.reshape(SIDE // CELL, -1)
    np.testing.assert_allclose(shape[:, inner], np.tile(-0.001 * WARP * centres, (8, 1))[:, inner], atol=2e-6)
    assert np.abs(along_rows).max() < 1e-6 and np.abs(mixed).max() < 1e-6  # it is the same in every row
    assert np.abs(other).max() > 1e-4


def test_what_nothing_is_known_of_stays_unknown() -> None:
    depth = np.ones((SIDE, SIDE), dtype=np.float32)
    depth[:100] = 0.0
    moved = warped(depth, np.diag([1.05, 1.0]), CENTRE)
    assert set(np.unique(moved)) <= {np.float32(0.0), np.float32(1.0)}
    assert np.count_nonzero(moved[:, 128] == 0.0) > 95


@pytest.mark.parametrize("matrix", [np.diag([1.01, 1.0]), np.diag([1.0, 0.99]), np.array([[1.0, 0.01], [0.0, 1.0]])])
def test_where_a_full_picture_is_known_is_found_once_for_all_pictures(matrix: np.ndarray) -> None:
    offset, ones = CENTRE - matrix @ CENTRE, np.ones((SIDE, SIDE), dtype=np.float32)
    inside = affine_transform(ones, matrix, offset, order=1) > 0.999
    for near in (0.8, 0.9, 0.8):
        depth = near * slope_picture().depth
        expected = np.where(inside, affine_transform(depth, matrix, offset, order=1), np.float32(0.0))
        np.testing.assert_array_equal(warped(depth, matrix, CENTRE), expected)


@pytest.mark.parametrize("share", [0.01, -0.01])
def test_a_camera_of_another_focal_length_warps_the_picture_as_predicted(share: float) -> None:
    """What the mixture offers for a focal length that is off equals what the longer lens sees of a flat slope."""
    reference = slope_picture()
    columns = np.indices((SIDE, SIDE))[1]
    camera = replace(CANONICAL_CAMERA, fx=CANONICAL_CAMERA.fx * (1 + share))
    there = (columns - camera.cx) * CANONICAL_CAMERA.fx / camera.fx + camera.cx
    change = measure((1.0 - 0.001 * there).astype(np.float32), reference, with_pixels=False).shape
    backward = 4 if share > 0 else 0  # a longer lens shows what a shrunk picture would
    predicted = abs(share) / WARP * warp_responses(reference, CANONICAL_CAMERA)[3 + backward, : reference.count]
    inside = (np.arange(reference.count) % 8 > 0) & (np.arange(reference.count) % 8 < 7)
    np.testing.assert_allclose(change[inside], predicted[inside], rtol=0.03, atol=3e-6)
