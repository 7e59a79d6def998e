"""Depth pictures against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from renderer.camera import CANONICAL_CAMERA, Camera, frontal_pose, ray_directions
from renderer.depth import panel_depth, render_buffers, render_depth, render_depths
from renderer.pose import INCLINATIONS_DEG, inclination_pose, pose_from_rotation, transform_points
from simcore.errors import InputError
from tests.renderer.surfaces import drape_like, height_field

POSE = frontal_pose()
VGA = Camera(640, 480, 475.0, 475.0, 319.5, 239.5)
LENS = Camera(320, 240, 240.0, 238.0, 161.0, 118.0, (-0.1, 0.04, 0.002, -0.001, 0.0))


@pytest.mark.parametrize("camera", [CANONICAL_CAMERA, VGA, LENS])
def test_a_flat_sheet_is_at_its_z_depth_everywhere(camera: Camera) -> None:
    """Ray length would be up to 15 % more in the corners."""
    vertices, triangles = height_field(lambda x, y: np.full_like(x, 0.05), x=(-2, 2), y=(-2, 2), cells=4)
    depth = render_depth(vertices, triangles, camera, POSE)
    np.testing.assert_allclose(depth, 0.85, rtol=0, atol=1e-6)


@pytest.mark.parametrize("camera", [CANONICAL_CAMERA, LENS])
def test_a_turned_camera_sees_the_panel_as_a_plane(camera: Camera) -> None:
    pose = pose_from_rotation((0.05, -0.08, 0.1), (0.02, -0.25, 0.95)) @ np.diag([1.0, -1.0, -1.0, 1.0])
    depth = panel_depth(camera, pose)
    points = transform_points(np.linalg.inv(pose), camera.back_project(depth))
    np.testing.assert_allclose(points[..., 2], 0.0, atol=1e-6)
    mesh = height_field(lambda x, y: np.zeros_like(x), x=(-2, 2), y=(-2, 2), cells=4)
    np.testing.assert_allclose(render_depth(*mesh, camera, pose, panel=False), depth, atol=1e-6)


def test_sphere() -> None:
    """A ball of radius 0.15 m at 0.8 m depth, from a fine mesh, to 1e-5 m away from its outline."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, 401), np.linspace(0, 2 * np.pi, 801), indexing="ij")
    centre = np.array([0.02, -0.25, 0.1])
    unit = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1).reshape(-1, 3)
    j, i = np.meshgrid(np.arange(400), np.arange(800), indexing="ij")
    a = (j * 801 + i).ravel()
    triangles = np.concatenate([np.stack([a, a + 1, a + 802], 1), np.stack([a, a + 802, a + 801], 1)])
    depth = render_depth(centre + 0.15 * unit, triangles, CANONICAL_CAMERA, POSE, panel=False)
    rays = ray_directions(CANONICAL_CAMERA)
    c = transform_points(POSE, centre)
    qa, qb, qc = np.sum(rays**2, -1), rays @ c, c @ c - 0.15**2
    root = qb**2 - qa * qc
    exact = (qb - np.sqrt(np.maximum(root, 0.0))) / qa
    inside = root > 2e-3
    assert inside.sum() > 5000
    np.testing.assert_allclose(depth[inside], exact[inside], rtol=0, atol=1e-5)
    assert np.all(depth[root < -1e-4] == 0.0)


def test_cylinder_with_vertical_axis() -> None:
    radius = 0.3
    mesh = height_field(lambda x, y: np.sqrt(radius**2 - x**2) - 0.2, x=(-0.2, 0.2), cells=400)
    depth = render_depth(*mesh, CANONICAL_CAMERA, POSE, panel=False)
    rays = ray_directions(CANONICAL_CAMERA)
    x, axis = rays[..., 0], 0.9 + 0.2  # (t x)^2 + (t - axis)^2 = r^2
    qa = x**2 + 1
    exact = (axis - np.sqrt(np.maximum(axis**2 - qa * (axis**2 - radius**2), 0))) / qa
    inside = (depth > 0) & (np.abs(x * exact) < 0.19)
    assert inside.sum() > 10000
    np.testing.assert_allclose(depth[inside], exact[inside], rtol=0, atol=1e-5)


def test_inclined_panel_and_cloth_turn_together() -> None:
    mesh = height_field(lambda x, y: np.full_like(x, 0.02), x=(-2, 2), y=(-2, 2), cells=4)
    (inclined,) = render_depths(*mesh, CANONICAL_CAMERA, POSE, (5.0,))
    points = transform_points(np.linalg.inv(POSE @ inclination_pose(5.0)), CANONICAL_CAMERA.back_project(inclined))
    np.testing.assert_allclose(points[..., 2], 0.02, atol=1e-6)
    middle = inclined[:, 128]
    assert middle[-1] < middle[0], "positive brings the hem towards the camera"


def test_several_inclinations_are_single_pictures_from_inclined_poses() -> None:
    vertices, triangles = drape_like()
    many = render_depths(vertices, triangles, CANONICAL_CAMERA, POSE, INCLINATIONS_DEG)
    assert many.shape == (11, 256, 256)
    for k in (0, 5, 10):
        pose = POSE @ inclination_pose(INCLINATIONS_DEG[k])
        assert np.array_equal(many[k], render_depth(vertices, triangles, CANONICAL_CAMERA, pose))


def test_same_bits_every_time() -> None:
    mesh, pose = drape_like(100), POSE @ inclination_pose(3.0)
    first = render_depth(*mesh, CANONICAL_CAMERA, pose)
    for _ in range(5):
        assert np.array_equal(first, render_depth(*mesh, CANONICAL_CAMERA, pose))


def test_without_a_panel_only_cloth_has_data() -> None:
    vertices, triangles = drape_like()
    bare = render_depth(vertices, triangles, CANONICAL_CAMERA, POSE, panel=False)
    buffers = render_buffers(vertices, triangles, CANONICAL_CAMERA, POSE)
    assert np.array_equal(bare > 0, buffers.cloth)
    assert np.array_equal(bare[buffers.cloth], buffers.depth[buffers.cloth])
    assert np.all(buffers.depth > 0)


def test_buffers_name_the_triangle_and_the_place_in_it() -> None:
    vertices, triangles = drape_like()
    buffers = render_buffers(vertices, triangles, CANONICAL_CAMERA, POSE)
    seen = buffers.cloth
    corners = vertices[triangles[buffers.triangle[seen]]]
    u, v = buffers.barycentric[seen].T
    points = np.einsum("nk,nkc->nc", np.stack([1 - u - v, u, v], 1), corners)
    np.testing.assert_allclose(transform_points(POSE, points)[:, 2], buffers.depth[seen], atol=1e-5)
    pixels = CANONICAL_CAMERA.project(transform_points(POSE, points))
    row, column = np.nonzero(seen)
    np.testing.assert_allclose(pixels, np.stack([column, row], 1), atol=1e-2)
    assert np.all(buffers.triangle[~seen] == -1)


def test_normals_are_unit_smooth_and_turned_to_the_camera() -> None:
    slope = 0.3
    mesh = height_field(lambda x, y: 0.2 + slope * x)
    buffers = render_buffers(*mesh, CANONICAL_CAMERA, POSE)
    expected = np.array([-slope, 0.0, -1.0]) / math.hypot(slope, 1.0)
    np.testing.assert_allclose(buffers.normals[buffers.cloth], np.tile(expected, (buffers.cloth.sum(), 1)), atol=1e-6)
    np.testing.assert_allclose(buffers.normals[~buffers.cloth], [[0, 0, -1]] * (~buffers.cloth).sum(), atol=1e-12)
    flipped = render_buffers(mesh[0], mesh[1][:, ::-1], CANONICAL_CAMERA, POSE)
    np.testing.assert_allclose(flipped.normals, buffers.normals, atol=1e-6)


def test_cloth_outside_the_view_leaves_the_panel() -> None:
    vertices, triangles = drape_like()
    depth = render_depth(vertices + np.array([5.0, 0.0, 0.0]), triangles, CANONICAL_CAMERA, POSE)
    np.testing.assert_allclose(depth, 0.9, atol=1e-6)
    behind = render_depth(vertices + np.array([0.0, 0.0, 3.0]), triangles, CANONICAL_CAMERA, POSE)
    np.testing.assert_allclose(behind, 0.9, atol=1e-6)


def test_bad_meshes_and_cameras_are_refused() -> None:
    vertices, triangles = drape_like()
    broken = vertices.copy()
    broken[7, 1] = np.nan
    for bad, code in (
        ((broken, triangles), "mesh_not_finite"),
        ((vertices, triangles[:0]), "mesh_empty"),
        ((vertices[:, :2], triangles), "mesh_shape"),
        ((vertices, triangles + 1), "mesh_indices"),
        ((vertices, triangles.astype(float)), "mesh_shape"),
    ):
        with pytest.raises(InputError) as error:
            render_depth(*bad, CANONICAL_CAMERA, POSE)
        assert error.value.code == code
    with pytest.raises(InputError) as error:
        render_depth(vertices, triangles, CANONICAL_CAMERA, POSE @ np.diag([-1.0, 1.0, -1.0, 1.0]))
    assert error.value.code == "camera_behind_panel"
