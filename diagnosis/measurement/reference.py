"""Where the pixels of a capture lie on the cloth, according to the simulated drape that is nearest to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.scene import SimulationScene
from renderer.depth import render_buffers
from simcore.drape import Drape

CELLS = 12
"""Cells of the cloth along u and along v."""
RING_CELLS = 6
"""Cells along each side of the strip around the cloth."""
RING_SHARE = 0.08
"""Width of that strip, as a share of the sample's longer edge."""
LEAST_PIXELS = 12
"""A cell seen by fewer pixels says nothing."""
PLANE_NAMES = ("panel_offset", "panel_slope_x", "panel_slope_y")
"""Numbers of the panel's plane, which stand behind those of the cells."""


@dataclass(frozen=True)
class Reference:
    """A rendered drape and the cell of every pixel.

    Attributes:
        depth: ideal z-depth [m], float32 [H, W].
        cell: int32 [H, W]: 0 .. cells-1 on the cloth (row-major in v, u), then the ring, -1 elsewhere.
        panel: panel seen away from cloth and ring, bool [H, W].
        edge: a depth edge is near, bool [H, W].
        slope: mean slope |grad z| of the cloth in each cell, [cells + ring].
        height: mean height over the panel (or over the cloth's mean plane) in each cell [m], [cells + ring].
        least_pixels: a cell seen by fewer pixels says nothing.
        centre: place of each cell in units of the sample, (u, v), [cells + ring, 2]; the ring lies outside [0, 1].
    """

    depth: NDArray[np.float32]
    cell: NDArray[np.int32]
    panel: NDArray[np.bool_]
    edge: NDArray[np.bool_]
    slope: NDArray[np.float64]
    height: NDArray[np.float64]
    centre: NDArray[np.float64]
    least_pixels: int = LEAST_PIXELS

    @property
    def count(self) -> int:
        """Number of cells with those of the ring."""
        return len(self.slope)

    @property
    def length(self) -> int:
        """Of a shape-and-plane vector measured against it: its cells, then the panel's plane."""
        return self.count + len(PLANE_NAMES)


def make_reference(drape: Drape, scene: SimulationScene, *, least_pixels: int = LEAST_PIXELS) -> Reference:
    """Render a drape and assign pixels to cells; cells seen by fewer than ``least_pixels`` say nothing."""
    from scipy import ndimage

    mesh = drape.mesh
    seen = render_buffers(
        drape.vertices,
        mesh.triangles,
        scene.camera,
        scene.camera_from_panel,
        panel=scene.setup.panel,
    )
    place = np.zeros((*seen.cloth.shape, 2))  # of the cloth's pixels alone
    uv = mesh.uv[mesh.triangles[seen.triangle[seen.cloth]]]  # [pixels, 3, 2]
    second, third = np.split(seen.barycentric[seen.cloth], 2, axis=1)
    place[seen.cloth] = uv[:, 0] * (1 - second - third) + uv[:, 1] * second + uv[:, 2] * third
    index = np.minimum((place * CELLS).astype(np.int32), CELLS - 1)
    cell = np.where(seen.cloth, index[..., 1] * CELLS + index[..., 0], -1).astype(np.int32)
    panel = (seen.depth > 0) & ~seen.cloth
    oblong = scene.camera.fx / scene.camera.fy  # height of a pixel over its width
    if seen.cloth.any():
        width = RING_SHARE * max(mesh.size_m) * scene.camera.fx / float(np.median(seen.depth[seen.cloth]))
        distance, nearest = ndimage.distance_transform_edt(~seen.cloth, sampling=(oblong, 1.0), return_indices=True)
        ring = ~seen.cloth & (distance <= width)
        at = place[nearest[0][ring], nearest[1][ring]]
        cell[ring] = CELLS * CELLS + _side_cell(at)
        panel &= distance > 1.25 * width
    cloth_depth = np.where(seen.cloth, seen.depth, np.nan)
    across, down = _differences(cloth_depth if not scene.setup.panel else seen.depth)
    jump = np.fmax(np.abs(across), np.abs(down))
    edge = ndimage.binary_dilation(np.nan_to_num(jump) > 0.006, iterations=2)
    total = CELLS * CELLS + 4 * RING_CELLS
    height = np.where(seen.cloth, np.nan_to_num(heights(seen.depth, scene)), 0.0)
    pixel = seen.depth / scene.camera.fx
    to_the_left, to_the_top = _differences(seen.depth)
    gradient = np.hypot(to_the_left, to_the_top / np.float32(oblong)) / np.maximum(pixel, 1e-6)
    steep = np.minimum(np.nan_to_num(gradient), 3.0)
    slope = _cell_mean(np.where(seen.cloth, steep, 0.0), cell, total)
    return Reference(
        seen.depth, cell, panel, edge, slope, _cell_mean(height, cell, total), cell_centres(), least_pixels
    )


def _side_cell(at: NDArray[np.float64]) -> NDArray[np.int32]:
    """Ring cell of places near the cloth's border: top, bottom, left, right, each ``RING_CELLS`` long."""
    u, v = at[:, 0], at[:, 1]
    side = np.argmin(np.stack([v, 1 - v, u, 1 - u]), axis=0)
    along = np.where(side < 2, u, v)
    return np.asarray(side * RING_CELLS + np.minimum((along * RING_CELLS).astype(int), RING_CELLS - 1), dtype=np.int32)


def _differences(depth: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Backward differences along columns and rows, same shape."""
    return np.diff(depth, axis=1, prepend=depth[:, :1]), np.diff(depth, axis=0, prepend=depth[:1])


def heights(depth: NDArray[np.floating], scene: SimulationScene) -> NDArray[np.float64]:
    """Height of each pixel's point over z = 0 of the panel frame [m], [H, W]; NaN where a picture [m] has no depth."""
    points = scene.camera.back_project(depth)
    pose = scene.camera_from_panel
    return np.asarray((points - pose[:3, 3]) @ pose[:3, 2])


def _cell_mean(values: NDArray[np.floating], cell: NDArray[np.int32], total: int) -> NDArray[np.float64]:
    inside = cell >= 0
    count = np.bincount(cell[inside], minlength=total)
    return np.bincount(cell[inside], values[inside], minlength=total) / np.maximum(count, 1)


def cell_centres() -> NDArray[np.float64]:
    """Place of each cell of the cloth, then of the ring, in units of the sample, (u, v), [cells + ring, 2]."""
    middle = (np.arange(CELLS) + 0.5) / CELLS
    v, u = np.meshgrid(middle, middle, indexing="ij")
    along = (np.arange(RING_CELLS) + 0.5) / RING_CELLS
    off = 0.5 * RING_SHARE
    ring = [
        np.stack([along, np.full(RING_CELLS, -off)], 1),
        np.stack([along, np.full(RING_CELLS, 1 + off)], 1),
        np.stack([np.full(RING_CELLS, -off), along], 1),
        np.stack([np.full(RING_CELLS, 1 + off), along], 1),
    ]
    return np.concatenate([np.stack([u.ravel(), v.ravel()], 1), *ring])
