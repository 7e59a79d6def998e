"""Finding the cloth, with and without a panel, in pictures of analytic sheets."""

from __future__ import annotations

import numpy as np
import pytest

from capture.capture_set import CaptureSet
from capture.components import surfaces
from capture.holes import drop_flying_pixels, fill_small_holes
from capture.plane import fit_plane
from capture.segment import find_panel, noise_m, segment_cloth
from renderer.camera import CANONICAL_CAMERA, Camera, frontal_pose
from renderer.depth import panel_depth, render_buffers
from simcore.errors import InputError
from simcore.scenes import Scene
from tests.capture.sheets import CAMERA, Sheet, make_sheet, turned_pose, with_noise

POSE = turned_pose((2.0, 6.0, 1.0))


def truth(sheet: Sheet, camera: Camera = CAMERA) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    return render_buffers(sheet.vertices, sheet.triangles, camera, POSE).cloth


def test_cloth_before_a_panel_is_found(hanging: Sheet) -> None:
    region = segment_cloth(with_noise(hanging.depth(CAMERA, POSE), 0.001, 0.02), CAMERA, hanging.setup)
    cloth = truth(hanging)
    assert region.plane is not None
    assert region.plane.distance_m == pytest.approx(-POSE[:3, 2] @ POSE[:3, 3], abs=5e-4)
    assert np.degrees(np.arccos(region.plane.normal @ POSE[:3, 2])) < 0.1
    assert region.noise_m == pytest.approx(0.001, rel=0.1)
    assert (region.standing & ~cloth).mean() < 0.005  # a rim of a pixel, from smoothing
    assert (region.standing & cloth).sum() / cloth.sum() > 0.9
    assert region.mask is region.standing  # the pose is not known


def test_cloth_lying_on_the_panel_is_expected_where_the_pose_is_known(stretched: Sheet) -> None:
    region = segment_cloth(with_noise(stretched.depth(CAMERA, POSE), 0.001, 0.0), CAMERA, stretched.setup, POSE)
    cloth = truth(stretched)
    overlap = (region.mask & cloth).sum() / (region.mask | cloth).sum()
    assert overlap > 0.93
    assert 0.1 < region.standing.sum() / cloth.sum() < 0.8


def test_cloth_without_a_panel_is_the_surface_of_its_size(hanging: Sheet) -> None:
    setup = make_sheet(Scene.HANGING, panel=False).setup
    depth = with_noise(hanging.depth(CAMERA, POSE, panel=False), 0.001, 0.35)
    depth[200:, 260:] = 0.6  # a hand, nearer but small
    depth[:30, :] = 2.0  # a wall
    region = segment_cloth(depth, CAMERA, setup)
    cloth = truth(hanging)
    assert region.plane is None
    assert region.holes == pytest.approx(0.35, abs=0.05)
    assert (region.mask & ~cloth).sum() == 0
    assert region.mask.sum() / (cloth & (depth > 0)).sum() > 0.98


def test_a_hidden_panel_leaves_the_cloth(hanging: Sheet) -> None:
    depth = hanging.depth(CAMERA, POSE, panel=False)
    assert segment_cloth(depth, CAMERA, hanging.setup).plane is None


@pytest.mark.parametrize("panel", [True, False])
def test_a_picture_of_nothing_is_refused(panel: bool) -> None:
    setup = make_sheet(Scene.HANGING, panel=panel).setup
    wall = with_noise(panel_depth(CAMERA, POSE), 0.001, 0.02)
    with pytest.raises(InputError) as caught:
        segment_cloth(wall, CAMERA, setup)
    assert caught.value.code == "cloth_not_found"


def test_specks_are_no_cloth() -> None:
    specks = np.zeros((240, 320), np.float32)
    specks[::40, ::40] = 0.9
    with pytest.raises(InputError) as caught:
        segment_cloth(specks, CAMERA, make_sheet(Scene.HANGING).setup)
    assert caught.value.code == "cloth_not_found"


def test_a_plane_is_fitted_among_outliers() -> None:
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (4000, 2)), 1.0 + rng.normal(0, 0.001, 4000)])
    points[:1500, 2] = rng.uniform(0.6, 0.95, 1500)
    plane = fit_plane(points, tolerance_m=0.005)
    assert plane is not None
    np.testing.assert_allclose(plane.normal, (0, 0, -1), atol=1e-3)
    assert plane.distance_m == pytest.approx(1.0, abs=2e-4)
    assert plane.rms_m == pytest.approx(0.001, rel=0.2)
    assert fit_plane(points[:10], tolerance_m=0.005) is None
    assert fit_plane(np.tile([[0.0, 0.0, 1.0]], (100, 1)), tolerance_m=0.005) is None


def test_the_panel_is_found_behind_cloth_that_fills_half_the_picture(stretched: Sheet) -> None:
    """As in the store's own pictures: a width taken from the residuals would settle between panel and cloth."""
    depth = stretched.depth(CANONICAL_CAMERA, frontal_pose())
    for pose in (None, frontal_pose()):
        plane = find_panel(depth, CANONICAL_CAMERA, stretched.setup, pose)
        assert plane is not None
        assert plane.distance_m == pytest.approx(0.9, abs=0.0007)
        assert plane.rms_m < 0.001


def test_a_panel_far_from_the_given_pose_is_found_all_the_same(hanging: Sheet) -> None:
    depth = hanging.depth(CAMERA, POSE)
    wrong = turned_pose((2.0, 6.0, 1.0), distance_m=1.4)
    plane = find_panel(depth, CAMERA, hanging.setup, wrong)
    assert plane is not None
    assert plane.distance_m == pytest.approx(-POSE[:3, 2] @ POSE[:3, 3], abs=1e-3)


def test_holes_on_a_slope_are_filled_exactly_and_those_at_steps_are_not() -> None:
    slope = panel_depth(CAMERA, turned_pose((5.0, 25.0, 5.0)))
    rng = np.random.default_rng(0)
    holed = np.where(rng.random(slope.shape) < 0.3, 0.0, slope).astype(np.float32)
    filled = fill_small_holes(holed, CAMERA)
    inner = np.s_[5:-5, 5:-5]
    assert (filled[inner] > 0).mean() > 0.999
    known = filled > 0
    np.testing.assert_allclose(filled[known], slope[known], atol=2e-5)
    step = np.full((40, 40), 1.0, np.float32)
    step[:, 20:] = 0.8
    step[20, 19] = 0.0
    step[20, 5] = 0.0
    mended = fill_small_holes(step, Camera(40, 40, 200.0, 200.0, 20.0, 20.0))
    assert mended[20, 19] == 0.0
    assert mended[20, 5] == pytest.approx(1.0)
    assert not fill_small_holes(np.zeros((8, 8), np.float32), Camera(8, 8, 8.0, 8.0, 4.0, 4.0)).any()


def test_flying_pixels_are_taken_out_and_nothing_else() -> None:
    camera = Camera(40, 40, 200.0, 200.0, 20.0, 20.0)
    step = np.full((40, 40), 1.0, np.float32)
    step[:, 20:] = 0.8
    flying = step.copy()
    flying[5:15, 19] = 0.9
    cleaned = drop_flying_pixels(flying, camera)
    assert not cleaned[5:15, 19].any()
    cleaned[5:15, 19] = step[5:15, 19]
    np.testing.assert_array_equal(cleaned, step)


def test_surfaces_end_at_steps_and_hold_over_gaps() -> None:
    depth = np.zeros((30, 30), np.float32)
    depth[::2, :12] = 1.0
    depth[::2, 12:] = 0.7
    labels, count = surfaces(depth, Camera(30, 30, 200.0, 200.0, 15.0, 15.0))
    assert count == 2
    assert set(np.unique(labels[:, :12])) == {0, labels[0, 0]}
    assert labels[0, 0] != labels[0, 20]


def test_noise_is_measured_on_any_slope() -> None:
    slope = panel_depth(CAMERA, turned_pose((0.0, 45.0, 0.0)))
    assert noise_m(slope) < 3e-5
    assert noise_m(with_noise(slope, 0.002, 0.1)) == pytest.approx(0.002, rel=0.1)
    assert noise_m(np.zeros((240, 320), np.float32)) == 0.0


def test_the_real_capture_is_found(shared_dir: object) -> None:
    capture = CaptureSet.load(f"{shared_dir}/real/phisft-r1").captures[0]
    region = segment_cloth(capture.read_depth(), capture.camera, capture.setup)
    assert region.mask.sum() > 0.99 * (capture.read_depth() > 0).sum()
    assert 0.2 < region.holes < 0.5
    assert region.noise_m < 0.001
