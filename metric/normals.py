"""Normal maps: the mean angle between two drapes' surfaces, pixel by pixel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metric.backends import Channel
from metric.pairwise import pairwise_table
from metric.render import DrapeRender, check_same_size

Normals = NDArray[np.float32]


class NormalAngle:
    """Mean angle between surface normals [rad] over the union of both surfaces; beside a surface stands the panel."""

    name = "normals"
    channel = Channel.DEPTH
    unit = "rad"
    fingerprint = "normal-angle/1"

    def features(self, renders: Sequence[DrapeRender]) -> list[Normals]:
        """Unit normals from the depth picture, camera frame, float32 [H, W, 3]; 0 where there is no surface."""
        check_same_size([r.need_depth().shape for r in renders])
        return [depth_normals(r) for r in renders]

    def table(self, a: Sequence[Normals], b: Sequence[Normals]) -> NDArray[np.float64]:
        """Mean angle [rad] of every pair, shape [len(a), len(b)]."""
        check_same_size([f.shape for f in (*a, *b)])
        return pairwise_table(a, b, _mean_angle)


def depth_normals(render: DrapeRender) -> Normals:
    """Normals by central differences of the back-projected points; 0 where a pixel or one of its four neighbours has no
    cloth. Towards the camera, camera frame (z forward), float32 [H, W, 3].
    """
    depth = render.need_depth().astype(np.float64)
    camera = render.camera
    v, u = np.mgrid[0 : depth.shape[0], 0 : depth.shape[1]]
    points = np.stack([(u - camera.cx) / camera.fx * depth, (v - camera.cy) / camera.fy * depth, depth], axis=2)
    normals = np.zeros(points.shape)
    along_u = points[1:-1, 2:] - points[1:-1, :-2]
    along_v = points[2:, 1:-1] - points[:-2, 1:-1]
    cross = np.cross(along_v, along_u)
    cross /= np.maximum(np.linalg.norm(cross, axis=2, keepdims=True), 1e-12)
    mask = render.mask
    inner = mask[1:-1, 1:-1] & mask[1:-1, 2:] & mask[1:-1, :-2] & mask[2:, 1:-1] & mask[:-2, 1:-1]
    normals[1:-1, 1:-1] = np.where(inner[:, :, None], cross, 0.0)
    return normals.astype(np.float32)


def _mean_angle(x: Normals, y: Normals) -> float:
    has_x, has_y = x[:, :, 2] != 0, y[:, :, 2] != 0
    union = has_x | has_y
    if not union.any():
        return 0.0
    panel = np.array([0.0, 0.0, -1.0], np.float32)
    first = np.where(has_x[:, :, None], x, panel)[union]
    second = np.where(has_y[:, :, None], y, panel)[union]
    # atan2 keeps small angles that arccos of a float32 product would lose
    half_sum, half_difference = np.linalg.norm(first + second, axis=1), np.linalg.norm(first - second, axis=1)
    return float(np.mean(2.0 * np.arctan2(half_difference, half_sum)))
