"""Small holes of depth pictures, closed without bridging steps."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from capture.picture import Depth
from renderer.camera import Camera

T = TypeVar("T", bound=np.generic)

STEP_FOOTPRINTS = 6.0
"""Neighbouring pixels whose depths differ by more than this many pixel footprints (a slope of 80 degrees) belong to
different surfaces."""


def step_share(camera: Camera) -> float:
    """Depth difference of neighbouring pixels, as a share of their depth, from which on they are different surfaces."""
    return STEP_FOOTPRINTS / float(np.sqrt(camera.fx * camera.fy))


def drop_flying_pixels(depth: Depth, camera: Camera) -> Depth:
    """Take out pixels that hang between two surfaces: a step to the front on one side and to the back on the other.

    Args:
        depth: z-depth [m], float32 [H, W], 0 = no data.
        camera: its camera.

    Returns:
        float32 [H, W], 0 where a pixel was taken out.
    """
    step = step_share(camera) * depth
    flying = np.zeros(depth.shape, dtype=np.bool_)
    for axis in (0, 1):
        before, here, after = (_along(depth, axis, k) for k in range(3))
        down, up = here - before, after - here
        between = (down * up > 0.0) & (np.minimum(np.abs(down), np.abs(up)) > _along(step, axis, 1))
        _along(flying, axis, 1)[...] |= between & (before > 0.0) & (here > 0.0) & (after > 0.0)
    return np.where(flying, np.float32(0.0), depth)


def _along(grid: NDArray[T], axis: int, k: int) -> NDArray[T]:
    """Every pixel but the outermost (k = 1), the one before it (0) or after it (2) along an axis."""
    window = slice(k, grid.shape[axis] - 2 + k)
    return grid[window] if axis == 0 else grid[:, window]


def fill_small_holes(depth: Depth, camera: Camera, *, reach_px: int = 2) -> Depth:
    """Fill pixels without data that have data all around, by a weighted plane through their neighbours.

    The plane is fitted to inverse depth, which is exactly linear over the picture for a flat surface. Holes next to a
    step (more than twice :func:`step_share` within the window) stay open, and so does everything outside; what lies
    beyond a step farther away does not count.

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
    step = 2.0 * step_share(camera) * farthest
    wanted &= (farthest - nearest) <= step
    filled = depth.copy()
    inner_filled = filled[window]
    inverse = _plane_values(inner, seen, wanted, 0.6 * reach_px + 0.4, nearest - step, farthest + step)
    inner_filled[wanted] = (1.0 / inverse).astype(np.float32)
    return filled


def _enclosed(known: NDArray[np.bool_], reach_px: int) -> NDArray[np.bool_]:
    padded = np.pad(known, reach_px, mode="edge")
    disk = ndimage.iterate_structure(ndimage.generate_binary_structure(2, 1), reach_px)
    closed: NDArray[np.bool_] = ndimage.binary_closing(padded, disk)
    return closed[reach_px:-reach_px, reach_px:-reach_px]


def _plane_values(
    depth: Depth,
    known: NDArray[np.bool_],
    wanted: NDArray[np.bool_],
    sigma_px: float,
    nearest: NDArray[np.floating],
    farthest: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Inverse depth at the wanted pixels by a plane through their neighbours, Gaussian weights, float64 [wanted].

    Neighbours before ``nearest`` or behind ``farthest`` are of another surface.
    """
    reach = int(np.ceil(2.5 * sigma_px))
    dy, dx = (offset.ravel() for offset in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    row, column = np.nonzero(wanted)
    inverse = np.pad(np.divide(1.0, depth, where=known, out=np.zeros(depth.shape, dtype=np.float64)), reach)
    values = inverse[row[:, None] + reach + dy, column[:, None] + reach + dx]
    most, least = (1.0 / np.maximum(bound[row, column], 1e-6) for bound in (nearest, farthest))
    same = (values >= least[:, None]) & (values <= most[:, None])
    weights = np.where((values > 0.0) & same, np.exp(-0.5 * (dx**2 + dy**2) / sigma_px**2), 0.0)
    terms = np.stack([np.ones(dx.shape), dx, dy], axis=1)
    matrix = np.einsum("nk,ki,kj->nij", weights, terms, terms, optimize=True)
    # A small ridge on the slopes, for lopsided neighbourhoods.
    matrix[:, [1, 2], [1, 2]] += 1e-3 * sigma_px**2 * matrix[:, :1, 0]
    centre = np.sum(weights * values, axis=1, keepdims=True) / matrix[:, 0, :1]
    right = (weights * (values - centre)) @ terms
    solution = np.linalg.solve(matrix, right[..., None])
    at_pixel: NDArray[np.float64] = solution[:, 0, 0] + centre[:, 0]
    return at_pixel
