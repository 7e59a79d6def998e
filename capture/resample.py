"""A depth picture seen from another camera: the grid of its pixels is meshed and drawn there with a depth buffer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from renderer.camera import Camera

_MAX_SPAN_PX = 16
"""Triangles larger than this in the target picture are not drawn: too little is known between their corners."""


def resample(
    points: NDArray[np.floating], usable: NDArray[np.bool_], step_m: float, depth: NDArray[np.floating], target: Camera
) -> NDArray[np.float32]:
    """Depth picture of a meshed grid of points.

    Args:
        points: of each source pixel [m], target camera's frame, shape [H, W, 3].
        usable: source pixels to draw, bool [H, W].
        step_m: source pixels whose source depths differ by more are not joined.
        depth: source z-depth [m], shape [H, W].
        target: an undistorted camera.

    Returns:
        z-depth in the target camera, float32 [target.height, target.width], 0 = nothing drawn. Exact on flat parts:
        inverse depth is interpolated.
    """
    z = np.where(usable & (points[..., 2] > 1e-3), points[..., 2], np.nan)
    with np.errstate(invalid="ignore"):
        column = points[..., 0] / z * target.fx + target.cx
        row = points[..., 1] / z * target.fy + target.cy
    corners = _triangles(np.isfinite(z), depth, step_m)
    x, y, inverse = column.ravel()[corners], row.ravel()[corners], (1.0 / z).ravel()[corners]
    nearest = np.zeros(target.height * target.width)
    _draw(x, y, inverse, target, nearest)
    with np.errstate(divide="ignore"):
        seen = np.where(nearest > 0.0, 1.0 / nearest, 0.0)
    return seen.reshape(target.height, target.width).astype(np.float32)


def _triangles(valid: NDArray[np.bool_], depth: NDArray[np.floating], step_m: float) -> NDArray[np.int64]:
    """Corner indices, int64 [T, 3]: two triangles where all four pixels of a cell are valid, one where three are."""
    height, width = valid.shape
    index = np.arange(height * width).reshape(height, width)
    a, b, c, d = (_corner(index, k) for k in range(4))
    va, vb, vc, vd = (_corner(valid, k) for k in range(4))
    za, zb, zc, zd = (_corner(depth, k) for k in range(4))
    # Cut along the diagonal with the smaller step, so that silhouettes stay where they are.
    falling = np.abs(za - zd) <= np.abs(zb - zc)
    falling = np.where(va & vd, falling | ~(vb & vc), False)
    parts = []
    for mask, triple in (
        (falling & va & vc & vd, (a, c, d)),
        (falling & va & vd & vb, (a, d, b)),
        (~falling & va & vc & vb, (a, c, b)),
        (~falling & vb & vc & vd, (b, c, d)),
    ):
        parts.append(np.stack([corner[mask] for corner in triple], axis=1))
    corners = np.concatenate(parts)
    z = depth.ravel()[corners]
    joined: NDArray[np.int64] = corners[z.max(axis=1) - z.min(axis=1) <= step_m]
    return joined


def _corner(grid: NDArray[np.generic], k: int) -> NDArray[np.generic]:
    """The grid at the top left, top right, bottom left or bottom right corner of every cell."""
    rows = slice(k // 2, grid.shape[0] - 1 + k // 2)
    columns = slice(k % 2, grid.shape[1] - 1 + k % 2)
    return grid[rows, columns]


def _draw(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    inverse: NDArray[np.float64],
    target: Camera,
    nearest: NDArray[np.float64],
) -> None:
    """Draw triangles, corners [T, 3], into a buffer of inverse depths [height * width], the largest winning."""
    left = np.maximum(np.ceil(x.min(axis=1) - 1e-9), 0).astype(np.int64)
    right = np.minimum(np.floor(x.max(axis=1) + 1e-9), target.width - 1).astype(np.int64)
    top = np.maximum(np.ceil(y.min(axis=1) - 1e-9), 0).astype(np.int64)
    bottom = np.minimum(np.floor(y.max(axis=1) + 1e-9), target.height - 1).astype(np.int64)
    wide, high = right - left, bottom - top
    keep = (wide >= 0) & (high >= 0) & (wide < _MAX_SPAN_PX) & (high < _MAX_SPAN_PX)
    x, y, inverse, left, top, wide, high = (part[keep] for part in (x, y, inverse, left, top, wide, high))
    for step_y in range(int(high.max(initial=-1)) + 1):
        for step_x in range(int(wide.max(initial=-1)) + 1):
            here = np.flatnonzero((wide >= step_x) & (high >= step_y))
            px, py = left[here] + step_x, top[here] + step_y
            weights = _barycentric(x[here], y[here], px, py)
            inside = np.all(weights >= -1e-9, axis=1)
            value = np.sum(weights[inside] * inverse[here[inside]], axis=1)
            np.maximum.at(nearest, py[inside] * target.width + px[inside], value)


def _barycentric(
    x: NDArray[np.float64], y: NDArray[np.float64], px: NDArray[np.int64], py: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Barycentric weights of pixels in triangles, float64 [T, 3]; -1 in triangles without area."""
    ax, ay = x[:, 0] - px, y[:, 0] - py
    bx, by = x[:, 1] - px, y[:, 1] - py
    cx, cy = x[:, 2] - px, y[:, 2] - py
    weights = np.stack([bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx], axis=1)
    area = weights.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        share: NDArray[np.float64] = np.where(np.abs(area) > 1e-12, weights / area, -1.0)
    return share
