"""Ray casting of one mesh from many views (Open3D ``RaycastingScene``, Embree; needs no GPU)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.camera import Camera, ray_directions
from renderer.pose import check_pose
from renderer.surface import check_surface

NO_TRIANGLE = -1
_THREADS = 1


@dataclass(frozen=True)
class RayHits:
    """What every pixel's ray meets first.

    Attributes:
        depth: z-depth [m], float32 [H, W]; ``inf`` where the ray misses.
        triangle: index of the triangle, int32 [H, W]; -1 where the ray misses.
        barycentric: weights (u, v) of the triangle's second and third corner, float32 [H, W, 2].
    """

    depth: NDArray[np.float32]
    triangle: NDArray[np.int32]
    barycentric: NDArray[np.float32]


class RayScene:
    """A mesh built once and cast from any camera and pose.

    Rays, not vertices, are moved for each view, and their directions have unit z in the camera frame, so that the
    parameter of a hit is its z-depth. Casts on one thread: a worker is one core, and the bits are the same on any
    machine load.

    Args:
        vertices: [m], panel frame, shape [V, 3].
        triangles: int, shape [T, 3].

    Raises:
        InputError: the mesh cannot be rendered (see :func:`~renderer.surface.check_surface`).
    """

    def __init__(self, vertices: ArrayLike, triangles: ArrayLike) -> None:
        import open3d as o3d

        self.vertices, self.triangles = check_surface(vertices, triangles)
        core, cpu = o3d.core, o3d.core.Device("CPU:0")
        self._scene: Any = o3d.t.geometry.RaycastingScene(nthreads=_THREADS)
        self._scene.add_triangles(
            core.Tensor(self.vertices.astype(np.float32), core.float32, cpu),
            core.Tensor(self.triangles.astype(np.uint32), core.uint32, cpu),
        )
        self._rays: Callable[[NDArray[np.float32]], Any] = lambda rays: core.Tensor(rays, core.float32, cpu)

    def cast(self, camera: Camera, camera_from_panel: ArrayLike) -> RayHits:
        """First hit of every pixel's ray.

        Args:
            camera: the camera, distortion included.
            camera_from_panel: pose, [4, 4] (a mesh that is inclined: pose @ ``inclination_pose``).
        """
        pose = check_pose(camera_from_panel)
        hits = RayHits(
            np.full((camera.height, camera.width), np.inf, dtype=np.float32),
            np.full((camera.height, camera.width), NO_TRIANGLE, dtype=np.int32),
            np.zeros((camera.height, camera.width, 2), dtype=np.float32),
        )
        window = self._window(camera, pose)
        if window is None:
            return hits
        rotation, origin = pose[:3, :3], -pose[:3, :3].T @ pose[:3, 3]
        directions = ray_directions(camera)[window]
        rays = np.empty((*directions.shape[:2], 6), dtype=np.float32)
        rays[..., :3] = origin
        rays[..., 3:] = directions @ rotation
        answer = self._scene.cast_rays(self._rays(rays), nthreads=_THREADS)
        hits.depth[window] = answer["t_hit"].numpy()
        hits.triangle[window] = answer["primitive_ids"].numpy().view(np.int32)  # "none" is 2**32 - 1, that is -1
        hits.barycentric[window] = answer["primitive_uvs"].numpy()
        return hits

    def _window(self, camera: Camera, pose: NDArray[np.float64]) -> tuple[slice, slice] | None:
        """Rows and columns whose rays may meet the mesh; None if there are none."""
        points = self.vertices @ pose[:3, :3].T + pose[:3, 3]
        if points[:, 2].max() <= 0.0:
            return None
        everything = (slice(0, camera.height), slice(0, camera.width))
        if points[:, 2].min() <= 1e-3:
            return everything
        seen = points[:, :2] / points[:, 2:]
        low, high = seen.min(axis=0) - 1e-6, seen.max(axis=0) + 1e-6
        x, y = ray_directions(camera)[..., 0], ray_directions(camera)[..., 1]
        if camera.distorted:
            inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
            rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
        else:  # x depends on the column alone, y on the row
            columns = np.flatnonzero((x[0] >= low[0]) & (x[0] <= high[0]))
            rows = np.flatnonzero((y[:, 0] >= low[1]) & (y[:, 0] <= high[1]))
        if rows.size == 0 or columns.size == 0:
            return None
        return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
