"""A depth picture seen from another camera: the grid of its pixels is meshed and drawn there with a depth buffer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from renderer.camera import Camera

T = TypeVar("T", bound=np.generic)

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
    with np.errstate(invalid="ignore", divide="ignore"):
        inverse = 1.0 / np.where(points[..., 2] > 1e-3, points[..., 2], np.nan)
        x = points[..., 0] * inverse * target.fx + target.cx
        y = points[..., 1] * inverse * target.fy + target.cy
        near = (np.abs(x - target.cx) < target.cx + _MAX_SPAN_PX) & (np.abs(y - target.cy) < target.cy + _MAX_SPAN_PX)
    corners = _triangles(usable & near, depth, step_m)
    nearest = np.zeros(target.height * target.width)
    _draw(
        [x.ravel()[k] for k in corners],
        [y.ravel()[k] for k in corners],
        [inverse.ravel()[k] for k in corners],
        target,
        nearest,
    )
    with np.errstate(divide="ignore"):
        seen = np.where(nearest > 0.0, 1.0 / nearest, 0.0)
    return seen.reshape(target.height, target.width).astype(np.float32)


def _triangles(
    valid: NDArray[np.bool_], depth: NDArray[np.floating], step_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Three corner indices, each int64 [T]: two triangles where all pixels of a cell are valid, one where three are."""
    a = np.arange(depth.size).reshape(depth.shape)[:-1, :-1]
    va, vb, vc, vd = (_corner(valid, k) for k in range(4))
    za, zb, zc, zd = (_corner(depth, k) for k in range(4))
    # Cut along the diagonal with the smaller step, so that silhouettes stay where they are.
    falling = va & vd & ((np.abs(za - zd) <= np.abs(zb - zc)) | ~(vb & vc))
    rising = ~falling & vb & vc
    right, below = 1, depth.shape[1]
    parts: list[tuple[NDArray[np.int64], ...]] = []
    for mask, depths, steps in (
        (falling & vc, (za, zc, zd), (0, below, below + right)),
        (falling & vb, (za, zd, zb), (0, below + right, right)),
        (rising & va, (za, zc, zb), (0, below, right)),
        (rising & vd, (zb, zc, zd), (right, below, below + right)),
    ):
        farthest = np.maximum(np.maximum(depths[0], depths[1]), depths[2])
        closest = np.minimum(np.minimum(depths[0], depths[1]), depths[2])
        first = a[mask & (farthest - closest <= step_m)]
        parts.append(tuple(first + step for step in steps))
    p, q, r = (np.concatenate([part[k] for part in parts]) for k in range(3))
    return p, q, r


def _corner(grid: NDArray[T], k: int) -> NDArray[T]:
    """The grid at the top left, top right, bottom left or bottom right corner of every cell."""
    rows = slice(k // 2, grid.shape[0] - 1 + k // 2)
    columns = slice(k % 2, grid.shape[1] - 1 + k % 2)
    return grid[rows, columns]


def _draw(
    x: Sequence[NDArray[np.float64]],
    y: Sequence[NDArray[np.float64]],
    inverse: Sequence[NDArray[np.float64]],
    target: Camera,
    nearest: NDArray[np.float64],
) -> None:
    """Draw triangles, three corners each [T], into a buffer of inverse depths [height * width], the largest winning."""
    left, right = _span(x, target.width)
    top, bottom = _span(y, target.height)
    wide, high = right - left, bottom - top
    keep = (wide >= 0) & (high >= 0) & (wide < _MAX_SPAN_PX) & (high < _MAX_SPAN_PX)
    x, y, inverse = ([corner[keep] for corner in part] for part in (x, y, inverse))
    left, top, wide, high = left[keep], top[keep], wide[keep], high[keep]
    for step_y in range(int(high.max(initial=-1)) + 1):
        for step_x in range(int(wide.max(initial=-1)) + 1):
            here = np.flatnonzero((wide >= step_x) & (high >= step_y))
            px, py = left[here] + step_x, top[here] + step_y
            ax, bx, cx = (corner[here] - px for corner in x)
            ay, by, cy = (corner[here] - py for corner in y)
            wa, wb, wc = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
            area = wa + wb + wc
            slack = -1e-9 * np.abs(area)
            sign = np.sign(area)
            inside = (wa * sign >= slack) & (wb * sign >= slack) & (wc * sign >= slack) & (np.abs(area) > 1e-12)
            chosen = here[inside]
            total = wa[inside] * inverse[0][chosen] + wb[inside] * inverse[1][chosen] + wc[inside] * inverse[2][chosen]
            np.maximum.at(nearest, py[inside] * target.width + px[inside], total / area[inside])


def _span(corners: Sequence[NDArray[np.float64]], size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last whole pixel between the corners' smallest and largest coordinate, within the picture."""
    low = np.minimum(np.minimum(corners[0], corners[1]), corners[2])
    high = np.maximum(np.maximum(corners[0], corners[1]), corners[2])
    first = np.maximum(np.ceil(low - 1e-9), 0.0).astype(np.int64)
    return first, np.minimum(np.floor(high + 1e-9), size - 1.0).astype(np.int64)
