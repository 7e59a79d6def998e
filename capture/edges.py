"""Registration of a stretched sample on its panel from the faint steps along its edges.

Most of a stretched sample lies within a millimetre of the panel, below the noise of one pixel. Along an edge of 0.5 m
there are hundreds of pixels, and the mean step from panel to cloth stands out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from capture.holes import fill_small_holes
from capture.outline import sample_corners
from capture.picture import Depth
from capture.plane import Plane
from renderer.camera import Camera
from simcore.errors import InputError
from simcore.scenes import Setup

_CELL_M, _CELL_SHARE = 0.002, 0.004
"""Edge of a cell of the height map at least [m], and as a share of the sample's size: no map is larger than 0.5 m's."""

_CLIP_M = 0.0005
"""Heights count up to this much, so that a wrinkle weighs no more than cloth that lies flat [m]."""

_OFFSETS_M = (0.003, 0.006, 0.009, 0.012)
"""Distances from the edge, on either side, at which heights are compared [m]."""

_SEARCH_SHARE = 0.08
"""How far the outline is looked for about its first place, as a share of the sample's size."""
_SEARCH_RAD = np.radians(3.0)
_BEYOND = 1.25
"""A best place farther out than this times what was looked at is none."""


@dataclass(frozen=True)
class _Edge:
    """Points along an edge [N, 2] and the unit normal [2] into the sample; panel frame."""

    points: NDArray[np.float64]
    inward: NDArray[np.float64]
    weight: float


def align_edges(
    depth: Depth,
    camera: Camera,
    setup: Setup,
    plane: Plane,
    frame: NDArray[np.float64],
    middle: NDArray[np.float64],
) -> NDArray[np.float64]:
    """``camera_from_panel`` that puts the sample's outline on the strongest steps in height, float64 [4, 4].

    Args:
        depth: z-depth [m], float32 [H, W].
        camera: its camera.
        setup: the pins.
        plane: the panel.
        frame: rows x, y, z of a first panel frame in the camera frame, z the panel's normal, float64 [3, 3].
        middle: first place of the midpoint of the top pins, on the panel, camera frame, float64 [3].

    Raises:
        InputError: ``pins_not_found``: the outline fits best outside of where it was looked for.
    """
    from scipy.optimize import minimize

    size_m = max(setup.sample_size_m)
    heights = _height_map(depth, camera, plane, frame, middle, size_m)
    edges = _edges(setup)
    scale = np.array([0.01, 0.01, np.radians(1.0)])

    def cost(scaled: NDArray[np.float64]) -> float:
        return -_step(heights, scaled * scale, edges, _cell_m(size_m))

    search = _SEARCH_SHARE * size_m
    shifts, turns = np.linspace(-search, search, 11), np.arange(-_SEARCH_RAD, _SEARCH_RAD + 1e-9, 0.0175)
    trials = np.stack(np.meshgrid(shifts, shifts, turns, indexing="ij"), axis=-1).reshape(-1, 3) / scale
    first = trials[int(np.argmin([cost(trial) for trial in trials]))]
    simplex = first + np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]])
    best = minimize(
        cost, first, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 0.01, "fatol": 1e-7}
    ).x
    right, up, turn = best * scale
    if max(abs(right), abs(up)) > _BEYOND * search or abs(turn) > _BEYOND * _SEARCH_RAD:
        raise InputError(
            "the edges of the stretched sample are not seen where its corners are: check sample_size_m and pins_m, add "
            "a hanging picture of the same camera, or give camera_from_panel",
            code="pins_not_found",
        )
    x = np.cos(turn) * frame[0] + np.sin(turn) * frame[1]
    y = np.cos(turn) * frame[1] - np.sin(turn) * frame[0]
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, y, frame[2]], axis=1)
    pose[:3, 3] = middle + right * frame[0] + up * frame[1]
    return pose


def _cell_m(size_m: float) -> float:
    """Edge of a cell of the height map of a sample whose longer edge is ``size_m`` [m]."""
    return max(_CELL_M, _CELL_SHARE * size_m)


def _height_map(
    depth: Depth,
    camera: Camera,
    plane: Plane,
    frame: NDArray[np.float64],
    middle: NDArray[np.float64],
    size_m: float,
) -> NDArray[np.float64]:
    """Clipped height over the panel on a square grid of :func:`_cell_m` around ``middle``, 1.5 sizes to each side."""
    cell_m = _cell_m(size_m)
    cells = round(1.5 * size_m / cell_m)
    x, y = np.meshgrid(np.arange(-cells, cells + 1) * cell_m, np.arange(-cells, cells + 1) * cell_m)
    pixels = camera.project(middle + x[..., None] * frame[0] + y[..., None] * frame[1])
    height = np.nan_to_num(plane.height(camera.back_project(fill_small_holes(depth, camera))), nan=0.0)
    # Clipped before it is smoothed, so that a high step does not spread.
    clipped = ndimage.gaussian_filter(np.clip(ndimage.median_filter(height, 3), -4 * _CLIP_M, 4 * _CLIP_M), 1.0)
    places = [np.nan_to_num(pixels[..., 1], nan=-9.0), np.nan_to_num(pixels[..., 0], nan=-9.0)]
    on_panel: NDArray[np.float64] = ndimage.map_coordinates(clipped, places, order=1, cval=0.0)
    return np.clip(on_panel, -_CLIP_M, _CLIP_M)


def _edges(setup: Setup) -> list[_Edge]:
    """Top, right and the upper half of the left edge; the rest moves with the fabric."""
    top_left, top_right, bottom_right, bottom_left = sample_corners(setup)[:, :2]
    parts = ((top_left, top_right, 0.02), (top_right, bottom_right, 0.02), (bottom_left, top_left, 0.5))
    edges = []
    for start, end, first in parts:
        along = (end - start) / np.linalg.norm(end - start)
        share = np.linspace(first, 0.98, 80)[:, None]
        edges.append(_Edge(start + share * (end - start), np.array([along[1], -along[0]]), 0.98 - first))
    return edges


def _step(heights: NDArray[np.float64], motion: NDArray[np.float64], edges: list[_Edge], cell_m: float) -> float:
    """Mean step over the edges [m], the outline moved by ``motion`` (x, y [m], turn [rad])."""
    right, up, turn = motion
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    total = 0.0
    for edge in edges:
        for side in (1.0, -1.0):
            points = np.concatenate([edge.points + side * offset * edge.inward for offset in _OFFSETS_M])
            cells = (points @ rotation.T + (right, up)) / cell_m + heights.shape[0] // 2
            values = ndimage.map_coordinates(heights, [cells[:, 1], cells[:, 0]], order=1)
            total += side * edge.weight * float(values.mean())
    return total
