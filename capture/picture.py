"""A capture's depth picture, read and checked against its camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from renderer.camera import Camera
from renderer.depth_png import dequantise_depth, read_counts
from simcore.errors import InputError

Depth = NDArray[np.float32]
"""z-depth [m], float32, shape [height, width], 0 = no data."""


def read_depth(path: Path, camera: Camera) -> Depth:
    """Read a 16-bit grey PNG in metres, float32, shape [height, width], 0 = no data.

    Raises:
        InputError: ``depth_missing``, ``depth_not_png``, ``depth_damaged``, ``depth_not_16_bit`` (see
            :mod:`renderer.depth_png`), ``depth_wrong_size`` (not as large as the camera says) or ``depth_empty``.
    """
    counts = read_counts(path)
    check_size(str(path), counts.shape[1], counts.shape[0], camera)
    if not counts.any():
        raise InputError(
            f"{path}: the depth picture is empty (every pixel is 0, no data): take it again", code="depth_empty"
        )
    return dequantise_depth(counts, camera.depth_unit_m)


def check_size(name: str, width: int, height: int, camera: Camera) -> None:
    """Refuse a picture that is not as large as its camera says.

    Raises:
        InputError: ``depth_wrong_size``, with the picture's ``name``.
    """
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"{name} is {width} x {height} pixels, its camera says {camera.width} x {camera.height}: "
            "correct the camera's width and height (and its fx, fy, cx, cy with them)",
            code="depth_wrong_size",
        )


def pixel_footprint_m(depth: Depth, camera: Camera) -> float:
    """What a pixel covers at the median depth of a picture [m], across the view; 0 for an empty picture."""
    seen = depth[depth > 0.0]
    return float(np.median(seen)) / float(np.sqrt(camera.fx * camera.fy)) if seen.size else 0.0
