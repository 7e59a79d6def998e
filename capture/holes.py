"""Small holes of depth pictures, closed without bridging steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from capture.picture import Depth, pixel_footprint_m
from renderer.camera import Camera

STEP_FOOTPRINTS = 6.0
"""Neighbouring pixels whose depths differ by more than this many pixel footprints (a slope of 80 degrees) belong to
different surfaces."""


def step_threshold_m(depth: Depth, camera: Camera) -> float:
    """Depth difference of neighbouring pixels [m] from which on they are taken for different surfaces."""
    return STEP_FOOTPRINTS * pixel_footprint_m(depth, camera)


def fill_small_holes(depth: Depth, camera: Camera, *, reach_px: int = 2) -> Depth:
    """Fill pixels without data that have data all around, by a weighted plane through their neighbours.

    The plane is fitted to inverse depth, which is exactly linear over the picture for a flat surface. Holes next to a
    step (more than twice :func:`step_threshold_m` within the window) stay open, and so does everything outside.

    Args:
        depth: z-depth [m], float32 [H, W], 0 = no data.
        camera: its camera.
        reach_px: half of the largest hole's width [pixel].

    Returns:
        float32 [H, W]; pixels with data are unchanged.
    """
    known = depth > 0.0
    if not known.any():
        return depth
    rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    inner, seen = depth[window], known[window]
    wanted = _enclosed(seen, reach_px) & ~seen
    if not wanted.any():
        return depth
    size = 2 * reach_px + 1
    nearest = ndimage.minimum_filter(np.where(seen, inner, np.float32(np.inf)), size)
    farthest = ndimage.maximum_filter(np.where(seen, inner, np.float32(0.0)), size)
    wanted &= (farthest - nearest) <= 2.0 * step_threshold_m(depth, camera)
    filled = depth.copy()
    inner_filled = filled[window]
    inner_filled[wanted] = (1.0 / _plane_values(inner, seen, wanted, 0.6 * reach_px + 0.4)).astype(np.float32)
    return filled


def _enclosed(known: NDArray[np.bool_], reach_px: int) -> NDArray[np.bool_]:
    padded = np.pad(known, reach_px, mode="edge")
    disk = ndimage.iterate_structure(ndimage.generate_binary_structure(2, 1), reach_px)
    closed: NDArray[np.bool_] = ndimage.binary_closing(padded, disk)
    return closed[reach_px:-reach_px, reach_px:-reach_px]


def _plane_values(
    depth: Depth, known: NDArray[np.bool_], wanted: NDArray[np.bool_], sigma_px: float
) -> NDArray[np.float64]:
    """Inverse depth at the wanted pixels by moving least squares with a Gaussian weight, float64 [wanted]."""
    weight = known.astype(np.float64)
    value = np.where(known, 1.0 / np.where(known, depth, 1.0), 0.0)
    mean = float(value[known].mean())
    value = np.where(known, value - mean, 0.0)
    row, column = np.mgrid[0 : depth.shape[0], 0 : depth.shape[1]].astype(np.float64)

    def moment(field: NDArray[np.float64]) -> NDArray[np.float64]:
        smoothed: NDArray[np.float64] = ndimage.gaussian_filter(field, sigma_px, mode="constant", truncate=3.0)
        return smoothed[wanted]

    x, y = column[wanted], row[wanted]
    w = moment(weight)
    wx, wy = moment(weight * column), moment(weight * row)
    wxx, wyy, wxy = moment(weight * column**2), moment(weight * row**2), moment(weight * column * row)
    wz, wxz, wyz = moment(value), moment(value * column), moment(value * row)
    # Centred at the wanted pixel, with a small ridge on the slopes for lopsided neighbourhoods.
    cx, cy = wx - w * x, wy - w * y
    cxx, cyy = wxx - 2 * x * wx + x * x * w, wyy - 2 * y * wy + y * y * w
    cxy = wxy - x * wy - y * wx + x * y * w
    cxz, cyz = wxz - x * wz, wyz - y * wz
    ridge = 1e-3 * w * sigma_px**2
    matrix = np.stack([w, cx, cy, cx, cxx + ridge, cxy, cy, cxy, cyy + ridge], axis=-1).reshape(-1, 3, 3)
    solution = np.linalg.solve(matrix, np.stack([wz, cxz, cyz], axis=-1)[..., None])
    value_at: NDArray[np.float64] = solution[:, 0, 0] + mean
    return value_at
