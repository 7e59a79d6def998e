"""Projection, distortion and poses."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from renderer.camera import CANONICAL_CAMERA, Camera, frontal_pose, ray_directions
from renderer.pose import (
    INCLINATIONS_DEG,
    check_pose,
    inclination_pose,
    invert_pose,
    pose_from_rotation,
    transform_points,
)
from simcore.errors import InputError

DISTORTED = Camera(640, 480, 475.0, 470.0, 322.5, 236.0, (-0.12, 0.05, 0.001, -0.002, 0.01))


def test_projection_follows_opencvs_formula() -> None:
    x, y, z = 0.21, -0.13, 0.87
    a, b = x / z, y / z
    r2 = a * a + b * b
    k1, k2, p1, p2, k3 = DISTORTED.distortion
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    column = 475.0 * (a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)) + 322.5
    row = 470.0 * (b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b) + 236.0
    np.testing.assert_allclose(DISTORTED.project((x, y, z)), (column, row), rtol=0, atol=1e-10)


@pytest.mark.parametrize("camera", [CANONICAL_CAMERA, DISTORTED])
def test_back_projection_inverts_projection_over_the_whole_picture(camera: Camera) -> None:
    depth = np.linspace(0.4, 1.2, camera.width * camera.height).reshape(camera.height, camera.width)
    pixels = camera.project(camera.back_project(depth))
    column, row = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    np.testing.assert_allclose(pixels, np.stack([column, row], axis=-1), rtol=0, atol=1e-6)


def test_no_data_back_projects_to_nan_and_points_behind_are_not_seen() -> None:
    depth = np.zeros((256, 256))
    depth[3, 4] = 1.0
    points = CANONICAL_CAMERA.back_project(depth)
    assert np.isfinite(points[3, 4]).all()
    assert np.isnan(points[0, 0]).all()
    assert np.isnan(CANONICAL_CAMERA.project((0.0, 0.0, -1.0))).all()


def test_rays_have_unit_depth_and_are_cached_read_only() -> None:
    rays = ray_directions(DISTORTED)
    assert rays is ray_directions(replace(DISTORTED))
    assert np.all(rays[..., 2] == 1.0)
    with pytest.raises(ValueError, match="read-only"):
        rays[0, 0, 0] = 1.0


def test_scaled_camera_keeps_the_pixel_borders() -> None:
    fine = DISTORTED.scaled(2)
    corner = DISTORTED.normalised_from_pixels((-0.5, -0.5))
    np.testing.assert_allclose(fine.normalised_from_pixels((-0.5, -0.5)), corner, atol=1e-9)
    assert (fine.width, fine.height) == (1280, 960)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"fx": 0.0}, "camera"),
        ({"cx": math.nan}, "camera"),
        ({"width": 0}, "camera"),
        ({"distortion": (0.0, 0.0)}, "camera"),
    ],
)
def test_bad_intrinsics_are_refused(change: dict[str, Any], code: str) -> None:
    with pytest.raises(InputError) as error:
        replace(CANONICAL_CAMERA, **change)
    assert error.value.code == code


@pytest.mark.parametrize("k1", [-2.0, -0.35])
def test_a_distortion_that_folds_the_picture_is_refused(k1: float) -> None:
    with pytest.raises(InputError, match=r"folds the picture over itself .* k1, k2, p1, p2, k3"):
        ray_directions(Camera(640, 480, 300.0, 300.0, 319.5, 239.5, (k1, 0.0, 0.0, 0.0, 0.0)))


@pytest.mark.parametrize("tangential", [0.0, 0.004])
def test_a_steep_wide_angle_lens_is_undone(tangential: float) -> None:
    """Towards its corners the picture grows more than twice as fast as the radius: a fixed point runs away there."""
    camera = Camera(64, 48, 30.0, 30.0, 31.5, 23.5, (-0.35, 0.15, tangential, -tangential, 0.0))
    column, row = np.meshgrid(np.arange(64), np.arange(48))
    rays = ray_directions(camera)
    np.testing.assert_allclose(camera.project(rays), np.stack([column, row], axis=-1), rtol=0, atol=1e-6)
    assert np.linalg.norm(rays[..., :2], axis=-1).max() < 1.6  # short of any other branch


def test_frontal_pose_sees_the_panel_straight_on() -> None:
    pose = check_pose(frontal_pose(0.9, -0.25))
    np.testing.assert_allclose(transform_points(pose, (0.0, -0.25, 0.0)), (0.0, 0.0, 0.9))
    np.testing.assert_allclose(transform_points(pose, (0.1, 0.0, 0.05)), (0.1, -0.25, 0.85))
    np.testing.assert_allclose(invert_pose(pose) @ pose, np.eye(4), atol=1e-15)


def test_inclination_turns_about_the_pins() -> None:
    assert len(INCLINATIONS_DEG) == 11
    pose = inclination_pose(5.0)
    np.testing.assert_allclose(transform_points(pose, (0.2, 0.0, 0.0)), (0.2, 0.0, 0.0), atol=1e-15)
    hem = transform_points(pose, (0.0, -0.5, 0.0))
    angle = math.radians(5.0)
    np.testing.assert_allclose(hem, (0.0, -0.5 * math.cos(angle), 0.5 * math.sin(angle)))


@pytest.mark.parametrize("degrees", [90.0, -46.0, math.nan])
def test_absurd_inclinations_are_refused(degrees: float) -> None:
    with pytest.raises(InputError, match=f"inclination {degrees} degrees must be from -45 to 45") as error:
        inclination_pose(degrees)
    assert error.value.code == "inclination"


@pytest.mark.parametrize(
    "pose", [np.eye(3), np.full((4, 4), np.nan), 2 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.ones((4, 4))]
)
def test_transforms_that_are_not_rigid_are_refused(pose: np.ndarray) -> None:
    with pytest.raises(InputError) as error:
        check_pose(pose)
    assert error.value.code == "pose"


def test_pose_from_rotation_vector() -> None:
    pose = pose_from_rotation((0.0, 0.0, math.pi / 2), (1.0, 2.0, 3.0))
    np.testing.assert_allclose(transform_points(pose, (1.0, 0.0, 0.0)), (1.0, 3.0, 3.0), atol=1e-15)
