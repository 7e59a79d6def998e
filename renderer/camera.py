"""Pinhole camera with lens distortion, and its pose against the panel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError


@dataclass(frozen=True)
class Camera:
    """Intrinsics in the OpenCV convention (pixel centres at whole numbers).

    Attributes:
        width, height: picture size [pixel].
        fx, fy, cx, cy: focal lengths and principal point [pixel].
        distortion: k1, k2, p1, p2, k3.
        depth_unit_m: metres per count of the 16-bit depth picture.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    depth_unit_m: float = 1e-4

    def __post_init__(self) -> None:
        numbers = (self.fx, self.fy, self.cx, self.cy, self.depth_unit_m, *self.distortion)
        if not all(math.isfinite(n) for n in numbers) or min(self.fx, self.fy, self.depth_unit_m) <= 0:
            raise InputError("camera intrinsics must be finite, focal lengths and depth unit positive", code="camera")
        if not (1 <= self.width <= 16384 and 1 <= self.height <= 16384):
            raise InputError(f"camera picture size {self.width} x {self.height} is not usable", code="camera")


CANONICAL_CAMERA = Camera(width=256, height=256, fx=320.0, fy=320.0, cx=127.5, cy=127.5)
"""The camera of the store and of the network's input: it sees 0.72 x 0.72 m at 0.9 m."""


def frontal_pose(distance_m: float = 0.9, centre_y_m: float = -0.25) -> NDArray[np.float64]:
    """``camera_from_panel`` of a camera that looks straight at the panel, float64, shape [4, 4].

    Panel frame: x right, y up, z towards the camera; camera frame: OpenCV (x right, y down, z forward).
    """
    return np.array(
        [[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, centre_y_m], [0.0, 0.0, -1.0, distance_m], [0.0, 0.0, 0.0, 1.0]]
    )
