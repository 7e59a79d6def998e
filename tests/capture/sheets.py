"""Analytic drapes put before a camera: pictures whose truth is known, made without a solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.camera import Camera
from renderer.depth import render_depth
from renderer.pose import invert_pose, pose_from_rotation
from simcore.mesh import GridMesh
from simcore.scenes import Scene, Setup

CAMERA = Camera(320, 240, 237.5, 237.5, 162.0, 118.0)


@dataclass(frozen=True)
class Sheet:
    """A cloth-like surface: hung as a hollow cone, or stretched with a fold along the diagonal."""

    setup: Setup
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]

    def depth(self, camera: Camera, pose: NDArray[np.float64], *, panel: bool = True) -> NDArray[np.float32]:
        """Its picture."""
        return render_depth(self.vertices, self.triangles, camera, pose, panel=panel)


def make_sheet(scene: Scene, size_m: float = 0.5, panel: bool = True) -> Sheet:
    """The sheet of a scene, its top corners at the nominal pins."""
    setup = Setup.nominal(scene, sample_size_m=(size_m, size_m), panel=panel)
    mesh = GridMesh(size_m / 50, (size_m, size_m))
    u, v = (mesh.material_coordinates / size_m).T
    corners = {name: np.asarray(place) for name, place in setup.pins_m.items()}
    left, right = corners["top_left"], corners["top_right"]
    if scene is Scene.HANGING:
        half = right[0] + (0.5 * size_m - right[0]) * v
        x, y = (2.0 * u - 1.0) * half, -v * size_m
        z = 0.24 * size_m * (1.0 - (2.0 * u - 1.0) ** 2) * (1.0 - 0.8 * v)
    else:
        low_left, low_right = np.array([-0.5 * size_m, -size_m, 0.0]), corners["bottom_right"]
        place = (1 - v)[:, None] * ((1 - u)[:, None] * left + u[:, None] * right)
        place += v[:, None] * ((1 - u)[:, None] * low_left + u[:, None] * low_right)
        x, y = place[:, 0], place[:, 1]
        fold = 0.03 * size_m * np.exp(-(((u - v) / 0.1) ** 2)) * np.sin(np.pi * u)
        z = fold + 0.06 * size_m * np.exp(-v / 0.12) * np.sin(np.pi * u) + 0.0006
    return Sheet(setup, np.stack([x, y, z], axis=1), mesh.triangles)


def turned_pose(
    degrees: tuple[float, float, float], distance_m: float = 0.95, aim: tuple[float, float, float] = (0.0, -0.25, 0.0)
) -> NDArray[np.float64]:
    """``camera_from_panel`` of a camera that looks at ``aim`` and is turned about x, y, z by so many degrees."""
    pose = pose_from_rotation(np.radians(degrees))
    pose[:3, :3] = pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = np.array([0.0, 0.0, distance_m]) - pose[:3, :3] @ np.asarray(aim)
    return pose


def difference(found: NDArray[np.float64], true: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Shift of the panel [m] and angle [degree] between two poses."""
    motion = invert_pose(true) @ found
    return motion[:3, 3], float(np.degrees(np.arccos(np.clip((np.trace(motion[:3, :3]) - 1) / 2, -1, 1))))


def with_noise(depth: NDArray[np.float32], noise_m: float, lost: float, seed: int = 0) -> NDArray[np.float32]:
    """Range noise and pixels without data."""
    rng = np.random.default_rng(seed)
    noisy = depth + rng.normal(0.0, noise_m, depth.shape)
    return np.where((depth > 0.0) & (rng.random(depth.shape) >= lost), noisy, 0.0).astype(np.float32)


def camera_document(camera: Camera = CAMERA) -> dict[str, Any]:
    """The camera in the format's words."""
    return {
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "depth_unit_m": camera.depth_unit_m,
    }
