"""Depth pictures of a drape before its panel, by ray casting."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.camera import Camera, ray_directions
from renderer.pose import check_pose, inclination_pose
from renderer.raycast import NO_TRIANGLE, RayHits, RayScene
from renderer.surface import triangle_areas, vertex_normals
from simcore.errors import InputError

_CONTACT_M = 1e-5
"""Cloth this far behind the panel's front still counts as lying on it [m]."""


@dataclass(frozen=True)
class DepthBuffers:
    """A depth picture with what was seen where.

    Attributes:
        depth: z-depth [m], float32 [H, W]; 0 = nothing.
        cloth: the pixel shows cloth, bool [H, W].
        triangle: index of the cloth's triangle, int32 [H, W]; -1 where there is no cloth.
        barycentric: weights of the triangle's second and third corner, float32 [H, W, 2]; 0 where there is no cloth.
    """

    depth: NDArray[np.float32]
    cloth: NDArray[np.bool_]
    triangle: NDArray[np.int32]
    barycentric: NDArray[np.float32]
    _make_normals: Callable[[], NDArray[np.float32]] = field(repr=False, compare=False)

    @cached_property
    def normals(self) -> NDArray[np.float32]:
        """Smooth unit normals of the side that is seen, camera frame, float32 [H, W, 3]; the panel's own on the panel,
        0 where there is nothing; made when they are asked for.
        """
        return self._make_normals()


def render_depth(
    vertices: ArrayLike,
    triangles: ArrayLike,
    camera: Camera,
    camera_from_panel: ArrayLike,
    *,
    panel: bool = True,
) -> NDArray[np.float32]:
    """z-depth of the first thing each pixel's ray meets.

    Args:
        vertices: drape [m], panel frame, shape [V, 3].
        triangles: int, shape [T, 3].
        camera: intrinsics with distortion.
        camera_from_panel: pose, [4, 4].
        panel: a panel stands at z = 0; it fills the picture.

    Returns:
        float32 [H, W], metres along the optical axis (never ray length), 0 = no data.

    Raises:
        InputError: mesh not finite or empty, pose not rigid, camera behind the panel.
    """
    picture: NDArray[np.float32] = render_depths(vertices, triangles, camera, camera_from_panel, (0.0,), panel=panel)[0]
    return picture


def render_depths(
    vertices: ArrayLike,
    triangles: ArrayLike,
    camera: Camera,
    camera_from_panel: ArrayLike,
    inclinations_deg: Sequence[float],
    *,
    panel: bool = True,
) -> NDArray[np.float32]:
    """:func:`render_depth` for several inclinations of one drape: the mesh is built once.

    The sample is inclined about the horizontal axis through its top pins together with its panel, against a camera
    that stays.

    Args:
        vertices, triangles, camera, camera_from_panel, panel: as for :func:`render_depth`.
        inclinations_deg: positive brings the hem towards the camera [degree].

    Returns:
        float32 [inclinations, H, W], metres.

    Raises:
        InputError: as :func:`render_depth`, or an inclination is absurd.
    """
    scene = RayScene(vertices, triangles)
    pose = check_pose(camera_from_panel)
    pictures = np.empty((len(inclinations_deg), camera.height, camera.width), dtype=np.float32)
    for k, inclination in enumerate(inclinations_deg):
        inclined = pose @ inclination_pose(inclination)
        behind = panel_depth(camera, inclined) if panel else None
        pictures[k] = _compose(scene.cast(camera, inclined), behind)[0]
    return pictures


def render_buffers(
    vertices: ArrayLike,
    triangles: ArrayLike,
    camera: Camera,
    camera_from_panel: ArrayLike,
    *,
    panel: bool = True,
) -> DepthBuffers:
    """:func:`render_depth` with the cloth's mask, triangles, barycentric weights and normals."""
    scene = RayScene(vertices, triangles)
    pose = check_pose(camera_from_panel)
    hits = scene.cast(camera, pose)
    behind = panel_depth(camera, pose) if panel else None
    depth, cloth = _compose(hits, behind)

    def make_normals() -> NDArray[np.float32]:
        normals = hit_normals(scene, hits, camera, pose)
        normals[~cloth] = 0.0
        if panel:
            normals[(depth > 0.0) & ~cloth] = pose[:3, 2]
        return normals

    triangle = np.where(cloth, hits.triangle, np.int32(NO_TRIANGLE))
    barycentric = np.where(cloth[..., None], hits.barycentric, np.float32(0.0))
    return DepthBuffers(depth, cloth, triangle, barycentric, make_normals)


def panel_depth(camera: Camera, camera_from_panel: ArrayLike) -> NDArray[np.float32]:
    """z-depth of the plane z = 0 of the panel frame, exact, float32 [H, W], read-only; ``inf`` where a ray misses it.

    Raises:
        InputError: the camera stands behind the panel.
    """
    return _panel_depth(camera, check_pose(camera_from_panel).tobytes())


@lru_cache(maxsize=8)
def _panel_depth(camera: Camera, pose_bytes: bytes) -> NDArray[np.float32]:
    """Of a pose [4, 4] in float64: one camera looks at one panel again and again."""
    pose = np.frombuffer(pose_bytes).reshape(4, 4)
    normal, origin = pose[:3, 2], pose[:3, 3]
    distance = float(normal @ origin)  # negative: the camera is on the front side
    if distance >= 0.0:
        raise InputError(
            "the camera stands behind the panel: correct camera_from_panel",
            code="camera_behind_panel",
        )
    slope = ray_directions(camera) @ normal
    with np.errstate(divide="ignore"):
        depth = np.where(slope < 0.0, distance / slope, np.inf).astype(np.float32)
    depth.setflags(write=False)
    return np.asarray(depth)


def hit_normals(
    scene: RayScene, hits: RayHits, camera: Camera, camera_from_panel: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Smooth unit normals at the hits, of the side seen, camera frame, float32 [H, W, 3]; 0 where rays miss.

    The side is that of the flat triangle, so that shading does not flip where smooth normals lean past a silhouette.
    """
    normals = np.zeros((camera.height, camera.width, 3), dtype=np.float32)
    seen = hits.triangle != NO_TRIANGLE
    triangle, rays = hits.triangle[seen], ray_directions(camera)[seen].astype(np.float32)
    rotation = camera_from_panel[:3, :3]
    at_vertices = (vertex_normals(scene.vertices, scene.triangles) @ rotation.T).astype(np.float32)
    corners = np.take(scene.triangles, triangle, axis=0)
    u, v = hits.barycentric[seen].T[..., None]
    smooth = (np.float32(1.0) - u - v) * np.take(at_vertices, corners[:, 0], axis=0)
    smooth += u * np.take(at_vertices, corners[:, 1], axis=0)
    smooth += v * np.take(at_vertices, corners[:, 2], axis=0)
    length = np.sqrt(np.einsum("nc,nc->n", smooth, smooth))
    flat = (triangle_areas(scene.vertices, scene.triangles) @ rotation.T).astype(np.float32)
    away = np.einsum("nc,nc->n", np.take(flat, triangle, axis=0), rays) > 0.0
    smooth *= (np.where(away, np.float32(-1.0), np.float32(1.0)) / np.maximum(length, np.float32(1e-12)))[:, None]
    normals[seen] = smooth
    return normals


def _compose(hits: RayHits, panel: NDArray[np.float32] | None) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Depth picture (0 = nothing) and cloth mask of cloth before an optional panel."""
    cloth = np.isfinite(hits.depth)
    depth = hits.depth
    if panel is not None:
        cloth &= hits.depth <= panel + np.float32(_CONTACT_M)
        depth = np.where(cloth, np.minimum(hits.depth, panel), panel)
    return np.where(np.isfinite(depth), depth, np.float32(0.0)), cloth
