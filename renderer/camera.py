"""Pinhole camera with lens distortion: projection, back-projection and the ray of every pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simcore.errors import InputError

_UNDISTORT_STEPS = 200
_UNDISTORT_TOLERANCE = 1e-10
_NEWTON_STEPS = 20
_WIDEST = 8.0
"""Of x/z: 83 degrees off the axis."""


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
        if len(self.distortion) != 5:
            raise InputError(
                f"distortion needs five numbers k1, k2, p1, p2, k3, got {len(self.distortion)}", code="camera"
            )
        object.__setattr__(self, "distortion", tuple(self.distortion))
        numbers = (self.fx, self.fy, self.cx, self.cy, self.depth_unit_m, *self.distortion)
        if not all(math.isfinite(n) for n in numbers) or min(self.fx, self.fy, self.depth_unit_m) <= 0:
            raise InputError("camera intrinsics must be finite, focal lengths and depth unit positive", code="camera")
        if not (1 <= self.width <= 16384 and 1 <= self.height <= 16384):
            raise InputError(f"camera picture size {self.width} x {self.height} is not usable", code="camera")

    @property
    def matrix(self) -> NDArray[np.float64]:
        """K, float64, shape [3, 3]."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def distorted(self) -> bool:
        """Some distortion coefficient is not zero."""
        return any(c != 0.0 for c in self.distortion)

    def scaled(self, factor: float) -> Camera:
        """The same view on a picture ``factor`` times as wide and high (pixel borders stay where they are).

        Raises:
            InputError: the scaled size is not a whole number of pixels.
        """
        width, height = self.width * factor, self.height * factor
        if abs(width - round(width)) > 1e-6 or abs(height - round(height)) > 1e-6:
            raise InputError(
                f"factor {factor} does not give whole pixels of {self.width} x {self.height}", code="camera"
            )
        return Camera(
            round(width),
            round(height),
            self.fx * factor,
            self.fy * factor,
            (self.cx + 0.5) * factor - 0.5,
            (self.cy + 0.5) * factor - 0.5,
            self.distortion,
            self.depth_unit_m,
        )

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Pixel coordinates (column, row) of points in the camera frame.

        Args:
            points: [m], camera frame, shape [..., 3]; depth z must be positive to be seen.

        Returns:
            float64, shape [..., 2]; NaN for points not in front of the camera.
        """
        p = np.asarray(points, dtype=np.float64)
        z = np.where(p[..., 2] > 0.0, p[..., 2], np.nan)
        return self.pixels_from_normalised(p[..., :2] / z[..., None])

    def pixels_from_normalised(self, normalised: ArrayLike) -> NDArray[np.float64]:
        """Distort normalised image coordinates (x/z, y/z), shape [..., 2], and scale them to pixels, shape [..., 2]."""
        distorted = _distort(np.asarray(normalised, dtype=np.float64), self.distortion)
        return distorted * (self.fx, self.fy) + (self.cx, self.cy)

    def normalised_from_pixels(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Undistorted normalised coordinates (x/z, y/z) of pixels (column, row), float64, shape [..., 2].

        The inverse of the distortion is found by fixed-point iteration, as OpenCV's ``undistortPoints`` does, but run
        until it stands; where it does not, by Newton's.

        Raises:
            InputError: the distortion has no inverse there (the coefficients fold the picture over itself).
        """
        distorted = (np.asarray(pixels, dtype=np.float64) - (self.cx, self.cy)) / (self.fx, self.fy)
        return _undistort(distorted, self.distortion) if self.distorted else distorted

    def back_project(self, depth: ArrayLike) -> NDArray[np.float64]:
        """Points of a depth picture in the camera frame.

        Args:
            depth: z-depth [m], shape [height, width]; 0 = no data.

        Returns:
            float64 [m], shape [height, width, 3]; NaN where there is no data.

        Raises:
            InputError: a picture of another size, or a distortion that has no inverse.
        """
        z = np.asarray(depth, dtype=np.float64)
        if z.shape != (self.height, self.width):
            raise InputError(
                f"depth picture of shape {z.shape} does not fit a camera of shape ({self.height}, {self.width})",
                code="depth_shape",
            )
        return ray_directions(self) * np.where(z > 0.0, z, np.nan)[..., None]


def _distort(xy: NDArray[np.float64], distortion: tuple[float, ...]) -> NDArray[np.float64]:
    """Brown-Conrady distortion of normalised coordinates, shape [..., 2]."""
    k1, k2, p1, p2, k3 = distortion
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=-1,
    )


def _undistort(xy: NDArray[np.float64], distortion: tuple[float, ...]) -> NDArray[np.float64]:
    """Inverse of :func:`_distort`: by fixed-point iteration, and by Newton's where that does not stand."""
    found = _by_fixed_point(xy, distortion)
    if found is None:
        found = _by_newton(xy, distortion)
    if found is None:
        raise InputError(
            f"lens distortion {distortion} folds the picture over itself before its edge is reached: give k1, k2, p1, "
            "p2, k3 in that order, of a calibration that holds up to the picture's corners",
            code="distortion",
        )
    return found


def _by_fixed_point(xy: NDArray[np.float64], distortion: tuple[float, ...]) -> NDArray[np.float64] | None:
    """As OpenCV does it; None where it does not stand: it runs away where a lens stretches the picture steeply."""
    k1, k2, _, _, k3 = distortion
    guess = xy.copy()
    for _ in range(_UNDISTORT_STEPS):
        r2 = np.sum(guess * guess, axis=-1, keepdims=True)
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if not np.all(radial > 0.05):
            break
        error = _distort(guess, distortion) - xy
        if np.max(np.abs(error), initial=0.0) < _UNDISTORT_TOLERANCE:
            return guess
        guess = guess - error / radial
    return None


def _by_newton(xy: NDArray[np.float64], distortion: tuple[float, ...]) -> NDArray[np.float64] | None:
    """From where the radial part alone has its inverse, short of its first fold; None where a point has none."""
    k1, k2, p1, p2, k3 = distortion
    radius = np.linspace(0.0, _WIDEST, 4001)
    r2 = radius * radius
    bent = radius * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))
    until = int(np.argmax(np.diff(bent) <= 0.0)) or len(bent) - 1
    size = np.linalg.norm(xy, axis=-1, keepdims=True)
    share = np.interp(size, bent[: until + 1], radius[: until + 1]) / np.maximum(size, 1e-12)
    guess: NDArray[np.float64] = xy * share
    for _ in range(_NEWTON_STEPS):
        error = _distort(guess, distortion) - xy
        if np.max(np.abs(error), initial=0.0) < _UNDISTORT_TOLERANCE:
            return guess
        x, y = guess[..., 0], guess[..., 1]
        r2 = x * x + y * y
        radial, steeper = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
        xx = radial + x * x * steeper + 2.0 * p1 * y + 6.0 * p2 * x
        yy = radial + y * y * steeper + 6.0 * p1 * y + 2.0 * p2 * x
        mixed = x * y * steeper + 2.0 * p1 * x + 2.0 * p2 * y
        determinant = xx * yy - mixed * mixed
        if not np.all(determinant > 0.0):
            break
        ex, ey = error[..., 0], error[..., 1]
        step = np.stack([yy * ex - mixed * ey, xx * ey - mixed * ex], axis=-1)
        guess = guess - step / determinant[..., None]
    return None


@lru_cache(maxsize=8)
def ray_directions(camera: Camera) -> NDArray[np.float64]:
    """Direction (x/z, y/z, 1) of every pixel's ray in the camera frame, float64, shape [height, width, 3], read-only.

    A point at parameter t of such a ray has z-depth t: casting it gives z-depth, never ray length. Cached per camera.
    """
    column, row = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    directions = np.ones((camera.height, camera.width, 3))
    directions[..., :2] = camera.normalised_from_pixels(np.stack([column, row], axis=-1))
    directions.setflags(write=False)
    return directions


CANONICAL_CAMERA = Camera(width=256, height=256, fx=320.0, fy=320.0, cx=127.5, cy=127.5)
"""The camera of the store and of the network's input: it sees 0.72 x 0.72 m at 0.9 m."""


def frontal_pose(distance_m: float = 0.9, centre_y_m: float = -0.25) -> NDArray[np.float64]:
    """``camera_from_panel`` of a camera that looks straight at the panel, float64, shape [4, 4].

    Panel frame: x right, y up, z towards the camera; camera frame: OpenCV (x right, y down, z forward). The optical
    axis meets the panel at (0, ``centre_y_m``, 0).
    """
    return np.array(
        [[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, centre_y_m], [0.0, 0.0, -1.0, distance_m], [0.0, 0.0, 0.0, 1.0]]
    )
