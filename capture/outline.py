"""Where the sample is expected to be, from its set-up alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.camera import Camera
from renderer.pose import check_pose, transform_points
from simcore.scenes import Scene, Setup


def sample_corners(setup: Setup) -> NDArray[np.float64]:
    """Top left, top right, bottom right, bottom left of the sample as put up, flat, [m] panel frame, float64 [4, 3].

    Corners that nothing holds are taken to hang straight below: half the sample's width to the side of the middle,
    its height below the pins.
    """
    width, height = setup.sample_size_m
    left, right = (np.asarray(setup.pins_m[name], dtype=np.float64) for name in ("top_left", "top_right"))
    middle = 0.5 * (left + right)
    free_left = middle + np.array([-0.5 * width, -height, 0.0])
    free_right = middle + np.array([0.5 * width, -height, 0.0])
    if setup.scene is Scene.STRETCH:
        free_right = np.asarray(setup.pins_m["bottom_right"], dtype=np.float64)
    return np.stack([left, right, free_right, free_left])


def expected_outline(camera: Camera, camera_from_panel: ArrayLike, setup: Setup) -> NDArray[np.bool_]:
    """Pixels inside the quadrilateral of :func:`sample_corners`, bool [H, W]; lens distortion bends its edges."""
    from PIL import Image, ImageDraw

    corners = sample_corners(setup)
    steps = np.linspace(0.0, 1.0, 33)[:-1, None]
    edges = np.concatenate([a + steps * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    pixels = camera.project(transform_points(check_pose(camera_from_panel), edges))
    if not np.all(np.isfinite(pixels)):
        return np.zeros((camera.height, camera.width), dtype=np.bool_)
    picture = Image.new("1", (camera.width, camera.height))
    ImageDraw.Draw(picture).polygon([(float(x), float(y)) for x, y in pixels], fill=1)
    return np.array(picture, dtype=np.bool_)
