"""The canonical view: identity where it should be, exact on planes, right to noise on drapes seen from elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from capture.normalise import (
    CANONICAL_DISTANCE_M,
    fill_holes,
    normalise_depth,
    put_up_otherwise,
)
from capture.resample import View, resample
from renderer.camera import CANONICAL_CAMERA, Camera, frontal_pose, ray_directions
from renderer.depth import panel_depth, render_depth
from simcore.errors import InputError
from simcore.scenes import Scene, Setup
from tests.capture.sheets import CAMERA, Sheet, make_sheet, turned_pose, with_noise

FINE = Camera(640, 480, 475.0, 475.0, 321.0, 236.0)
LENS = Camera(640, 480, 475.0, 475.0, 321.0, 236.0, (0.12, -0.2, 0.001, -0.0015, 0.05))
POSE = turned_pose((2.0, 8.0, 1.5))


def heights(sheet: Sheet, *, panel: bool = True) -> NDArray[np.float32]:
    depth = sheet.depth(CANONICAL_CAMERA, frontal_pose(), panel=panel)
    return np.where(depth > 0.0, np.float32(CANONICAL_DISTANCE_M) - depth, np.float32(0.0))


def away_from_steps(truth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels more than two from a step in height."""
    steps = ndimage.maximum_filter(truth, 3) - ndimage.minimum_filter(truth, 3) > 0.012
    return ~ndimage.binary_dilation(steps, iterations=2)


def test_the_canonical_cameras_own_picture_is_only_turned_into_heights(hanging: Sheet) -> None:
    depth = hanging.depth(CANONICAL_CAMERA, frontal_pose())
    seen = normalise_depth(depth, CANONICAL_CAMERA, frontal_pose(), hanging.setup)
    np.testing.assert_array_equal(seen.height, np.float32(CANONICAL_DISTANCE_M) - depth)
    assert seen.mask.all()
    assert seen.scene is Scene.HANGING
    assert seen.length_scale == 1.0
    assert seen.height.dtype == np.float32
    assert seen.height.max() == pytest.approx(0.12, abs=0.002)
    coarser_unit = Camera(256, 256, 320.0, 320.0, 127.5, 127.5, depth_unit_m=1e-3)
    again = normalise_depth(depth, coarser_unit, frontal_pose(), hanging.setup)
    np.testing.assert_array_equal(again.height, seen.height)


@pytest.mark.parametrize("camera", [FINE, LENS], ids=["pinhole", "distorted"])
@pytest.mark.parametrize("scene", list(Scene))
def test_a_drape_seen_from_elsewhere_is_the_same_drape(scene: Scene, camera: Camera) -> None:
    sheet = make_sheet(scene)
    seen = normalise_depth(sheet.depth(camera, POSE), camera, POSE, sheet.setup)
    truth = heights(sheet)
    inner = away_from_steps(truth) & seen.mask
    error = 1e3 * (seen.height - truth)
    assert seen.mask.mean() > 0.99
    assert np.sqrt(np.mean(error[inner] ** 2)) < 0.15
    assert np.median(np.abs(error)) < 0.02


@pytest.mark.parametrize("angle", [10.0, 30.0, 45.0])  # at 0 all of an edge falls on one side of a pixel
@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (1.0, -6.0, 2.0)], ids=["frontal", "turned"])
def test_a_silhouette_is_as_high_as_one_of_its_sides(angle: float, turned: tuple[float, float, float]) -> None:
    """A square 50 mm before the panel: what it hides from one camera and not from the other is panel, no ramp."""
    half = 0.15 * np.sqrt(2.0)
    around = np.radians(angle + 45.0 + 90.0 * np.arange(4))
    corners = np.stack([half * np.cos(around), half * np.sin(around) - 0.25, np.full(4, 0.05)], axis=1)
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    pose = turned_pose(turned)
    seen = normalise_depth(render_depth(corners, faces, FINE, pose), FINE, pose, Setup.nominal("hanging"))
    truth = CANONICAL_DISTANCE_M - render_depth(corners, faces, CANONICAL_CAMERA, frontal_pose())
    assert not ((seen.height > 0.005) & (seen.height < 0.045)).any()
    stands = truth > 0.025
    outline = stands & ~ndimage.binary_erosion(stands)
    assert ((seen.height > 0.025) != stands).sum() < 0.5 * outline.sum()  # half a pixel


def test_a_slope_is_no_step() -> None:
    height = np.fromfunction(lambda v, u: 0.004 * u, (256, 256)).astype(np.float32)  # 4 mm a pixel
    known = np.ones(height.shape, dtype=bool)
    known[100:103, 100:103] = False
    filled, whole = fill_holes(np.where(known, height, np.float32(0.0)), known)
    assert whole.all() and np.abs(filled - height).max() < 0.004


def test_noise_and_holes_stay_small(hanging: Sheet) -> None:
    depth = with_noise(hanging.depth(FINE, POSE), 0.001, 0.1)
    seen = normalise_depth(depth, FINE, POSE, hanging.setup)
    truth = heights(hanging)
    inner = away_from_steps(truth)
    assert seen.mask[inner].mean() > 0.999
    assert 1e3 * np.sqrt(np.mean((seen.height - truth)[inner] ** 2)) < 1.0


@given(st.tuples(st.floats(-12, 12), st.floats(-12, 12), st.floats(-12, 12)), st.floats(0.8, 1.3))
@settings(max_examples=15, deadline=None)
def test_a_bare_panel_has_no_height_from_anywhere(turned: tuple[float, float, float], distance_m: float) -> None:
    pose = turned_pose(turned, distance_m)
    seen = normalise_depth(panel_depth(CAMERA, pose), CAMERA, pose, Setup.nominal("hanging"))
    assert seen.mask.mean() > 0.5
    assert np.abs(seen.height).max() < 2e-5


def test_without_a_panel_only_the_cloth_counts(hanging: Sheet) -> None:
    setup = make_sheet(Scene.HANGING, panel=False).setup
    depth = hanging.depth(FINE, POSE, panel=False)
    cloth = depth > 0.0
    depth[~cloth] = 1.6  # a wall
    seen = normalise_depth(depth, FINE, POSE, setup, cloth=cloth)
    truth = heights(hanging, panel=False)
    there = hanging.depth(CANONICAL_CAMERA, frontal_pose(), panel=False) > 0.0
    assert (seen.mask != there).mean() < 0.01
    assert not seen.height[~seen.mask].any()
    inner = ndimage.binary_erosion(there, iterations=3)
    assert np.abs(seen.height - truth)[inner].max() < 0.001


def test_a_larger_sample_is_scaled_to_the_networks(hanging: Sheet) -> None:
    large = make_sheet(Scene.HANGING, size_m=0.7)
    pose = turned_pose((0.0, 5.0, 0.0), distance_m=1.3, aim=(0.0, -0.35, 0.0))
    seen = normalise_depth(large.depth(FINE, pose), FINE, pose, large.setup)
    truth = heights(hanging)
    inner = away_from_steps(truth) & seen.mask
    assert seen.length_scale == pytest.approx(1.4)
    assert 1e3 * np.sqrt(np.mean((seen.height - truth)[inner] ** 2)) < 0.2


def test_what_does_not_fit_is_refused(hanging: Sheet) -> None:
    depth = hanging.depth(CAMERA, POSE)
    with pytest.raises(InputError) as caught:
        normalise_depth(depth[:10], CAMERA, POSE, hanging.setup)
    assert caught.value.code == "depth_shape"
    with pytest.raises(InputError) as caught:
        normalise_depth(depth, CAMERA, np.eye(4) * 2.0, hanging.setup)
    assert caught.value.code == "pose"
    away = turned_pose((0.0, 0.0, 0.0), aim=(40.0, 0.0, 0.0))
    with pytest.raises(InputError) as caught:
        normalise_depth(depth, CAMERA, away, hanging.setup)
    assert caught.value.code == "nothing_in_view"


def test_a_surface_in_front_hides_what_is_behind() -> None:
    camera = Camera(64, 64, 80.0, 80.0, 31.5, 31.5)
    depth = np.full((64, 64), 1.0, np.float32)
    depth[20:44, 20:44] = 0.7
    view = View(ray_directions(camera), np.array([0.05, 0.0, 0.0]), camera)
    seen = resample(depth, view, 0.05)
    assert {round(float(z), 4) for z in np.unique(seen)} <= {0.0, 0.7, 1.0}
    shift = round(0.05 / 0.7 * 80.0)
    assert seen[32, 20 + shift] == pytest.approx(0.7)
    assert seen[32, 43 + shift] == pytest.approx(0.7)
    assert seen[32, 46 + shift] == pytest.approx(1.0)
    assert (seen[32, 10:60] == 0.0).sum() <= 3  # what the front hid from the source


@pytest.mark.parametrize("scene", ["hanging", "stretch"])
def test_how_a_sample_is_put_up_otherwise_is_told(scene: str) -> None:
    nominal = Setup.nominal(scene)
    pulled = nominal.with_pins(top_left=(nominal.pins_m["top_left"][0] + 0.02, 0.0, 0.0))
    close = nominal.with_pins(top_left=(nominal.pins_m["top_left"][0] + 0.006, 0.0, 0.0))
    assert put_up_otherwise(nominal) == put_up_otherwise(close) == ()
    assert put_up_otherwise(replace(nominal, pin_radius_m=0.0)) == ()
    assert put_up_otherwise(Setup.nominal(scene, sample_size_m=(0.25, 0.25))) == ()
    assert put_up_otherwise(replace(nominal, panel=False)) == ("no panel stands behind the sample",)
    assert "20 mm from the nominal ones" in put_up_otherwise(pulled)[0]
    assert put_up_otherwise(replace(nominal, pin_radius_m=0.03)) == ()  # goes by what a network learnt from
    assert put_up_otherwise(Setup.nominal(scene, sample_size_m=(0.5, 0.4))) == ("the sample is not square",)
