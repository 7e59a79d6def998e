"""A depth picture seen from another camera: the grid of its pixels is meshed and drawn there with a depth buffer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from renderer.camera import Camera

T = TypeVar("T", bound=np.generic)

_MAX_SPAN_PX = 16
"""Triangles larger than this in the target picture are not drawn: too little is known between their corners."""


@dataclass(frozen=True)
class View:
    """How the source's pixels are seen from the target camera.

    Attributes:
        directions: of the source pixels' rays, times the rotation into the target's frame and a scale, [H, W, 3].
        origin: the source camera in the target's frame [m], [3].
        target: an undistorted camera.
    """

    directions: NDArray[np.float64]
    origin: NDArray[np.float64]
    target: Camera

    def see(
        self, directions: NDArray[np.float64], depth: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Column, row [pixel] and inverse depth [1/m] in the target of points on rays; NaN behind the target camera."""
        points = directions * depth[..., None] + self.origin
        with np.errstate(invalid="ignore", divide="ignore"):
            inverse = 1.0 / np.where(points[..., 2] > 1e-3, points[..., 2], np.nan)
        x = points[..., 0] * inverse * self.target.fx + self.target.cx
        y = points[..., 1] * inverse * self.target.fy + self.target.cy
        return x, y, inverse


def resample(depth: NDArray[np.floating], view: View, step: float) -> NDArray[np.float32]:
    """Depth picture seen by the target camera.

    Neighbouring pixels are joined by triangles; where they are not (a step, or no data on one side), each surface is
    carried on for half a pixel, as far as its last pixel saw.

    Args:
        depth: source z-depth [m], shape [H, W], 0 = no data.
        view: from source to target.
        step: neighbours whose source depths differ by more than this share of the farthest are not joined.

    Returns:
        z-depth in the target camera, float32 [target.height, target.width], 0 = nothing drawn. Exact on flat parts:
        inverse depth is interpolated.
    """
    target = view.target
    x, y, inverse = view.see(view.directions, depth)
    with np.errstate(invalid="ignore"):
        near = (np.abs(x - target.cx) < target.cx + _MAX_SPAN_PX) & (np.abs(y - target.cy) < target.cy + _MAX_SPAN_PX)
    usable = near & (depth > 0.0)
    corners, left_out = _triangles(usable, depth, step)
    nearest = np.zeros(target.height * target.width)
    triangle = tuple([grid.ravel()[k] for k in corners] for grid in (x, y, inverse))
    _draw(triangle[0], triangle[1], triangle[2], target, nearest)
    _draw_borders(depth, usable, left_out, view, nearest)
    with np.errstate(divide="ignore"):
        seen = np.where(nearest > 0.0, 1.0 / nearest, 0.0)
    return seen.reshape(target.height, target.width).astype(np.float32)


def _draw_borders(
    depth: NDArray[np.floating],
    usable: NDArray[np.bool_],
    left_out: NDArray[np.bool_],
    view: View,
    nearest: NDArray[np.float64],
) -> None:
    """Draw what no triangle covers of the quarter of a cell next to each pixel, at that pixel's depth.

    Args:
        left_out: by corner (:func:`_corner`), cells in which no triangle has it, bool [4, H - 1, W - 1].
    """
    directions = view.directions
    for down in (0, 1):
        for right in (0, 1):
            own_corner, beside, under = 2 * down + right, 2 * down + 1 - right, 2 * (1 - down) + right
            own_out = left_out[own_corner]
            towards_side, towards_below = own_out | left_out[beside], own_out | left_out[under]
            row, column = np.nonzero((towards_side | towards_below) & _corner(usable, own_corner))
            own = directions[row + down, column + right]
            across = 0.5 * (own + directions[row + down, column + 1 - right])
            below = 0.5 * (own + directions[row + 1 - down, column + right])
            other = directions[row + 1 - down, column] + directions[row + 1 - down, column + 1]
            middle = 0.5 * across + 0.25 * other
            z = depth[row + down, column + right]
            a, b, c, d = (view.see(ray, z) for ray in (own, across, below, middle))
            for corners, wanted in (((a, b, d), towards_side), ((a, d, c), towards_below)):
                here = wanted[row, column]
                x, y, inverse = ([corner[k][here] for corner in corners] for k in range(3))
                _draw(x, y, inverse, view.target, nearest)


def _triangles(
    valid: NDArray[np.bool_], depth: NDArray[np.floating], step: float
) -> tuple[tuple[NDArray[np.int64], ...], NDArray[np.bool_]]:
    """Three corner indices, each int64 [T], and by corner the cells where no triangle has it, bool [4, H - 1, W - 1].

    Two triangles where all pixels of a cell are valid and joined, one where three are.
    """
    a = np.arange(depth.size).reshape(depth.shape)[:-1, :-1]
    va, vb, vc, vd = (_corner(valid, k) for k in range(4))
    za, zb, zc, zd = (_corner(depth, k) for k in range(4))
    # Cut along the diagonal with the smaller step, so that silhouettes stay where they are.
    falling = va & vd & ((np.abs(za - zd) <= np.abs(zb - zc)) | ~(vb & vc))
    rising = ~falling & vb & vc
    right, below = 1, depth.shape[1]
    parts: list[tuple[NDArray[np.int64], ...]] = []
    left_out = np.ones((4, *a.shape), dtype=np.bool_)
    z, offsets = (za, zb, zc, zd), (0, right, below, below + right)
    for mask, members in (
        (falling & vc, (0, 2, 3)),
        (falling & vb, (0, 3, 1)),
        (rising & va, (0, 2, 1)),
        (rising & vd, (1, 2, 3)),
    ):
        depths = [z[k] for k in members]
        farthest = np.maximum(np.maximum(depths[0], depths[1]), depths[2])
        closest = np.minimum(np.minimum(depths[0], depths[1]), depths[2])
        drawn = mask & (farthest - closest <= step * farthest)
        left_out[list(members)] &= ~drawn
        first = a[drawn]
        parts.append(tuple(first + offsets[k] for k in members))
    return tuple(np.concatenate([part[k] for part in parts]) for k in range(3)), left_out


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
