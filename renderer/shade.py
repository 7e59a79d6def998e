"""Shaded pictures: white Lambertian cloth on black, the same camera as the depth pictures."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.camera import Camera
from renderer.depth import hit_normals
from renderer.light import Light, encode_srgb
from renderer.pose import check_pose, inclination_pose
from renderer.raycast import NO_TRIANGLE, RayScene
from renderer.refine import SMOOTH_CELLS, grid_shape, refine_grid
from renderer.surface import check_surface
from simcore.errors import DrapemeterError, InputError

DEFAULT_LIGHT = Light()


class ShadeEngine(StrEnum):
    """What draws: ``raycast`` (Embree; the default, deterministic) or ``filament`` (Open3D's offscreen renderer)."""

    RAYCAST = "raycast"
    FILAMENT = "filament"

    @classmethod
    def parse(cls, name: str) -> ShadeEngine:
        """Engine by name.

        Raises:
            InputError: unknown name.
        """
        try:
            return cls(name)
        except ValueError:
            raise InputError(
                f"unknown shading engine {name!r}: choose {' or '.join(e.value for e in cls)}", code="engine_unknown"
            ) from None


class ShadedRenderer:
    """Draws drapes with one camera and one light.

    Both engines give the same picture within a few grey levels; which to take and why stands in
    ``docs/decisions/002-shading-by-ray-casting.md``. An engine that cannot run is an error, not replaced by the other.

    Args:
        camera: the camera, the same as that of the depth pictures.
        engine: ``raycast`` or ``filament``.
        light: the light; it stays with the camera.
        supersample: samples a pixel along each axis, averaged in linear light.
        smooth_cells: a coarser regular grid is refined to this many cells a side by splines (see
            :mod:`renderer.refine`), so that facets and beads of the mesh do not show; 0 = draw the triangles as given.

    Raises:
        InputError: unknown engine, bad supersampling, or (``filament``) a distorted camera.
        MissingResourceError: ``filament`` without a working Vulkan device.
    """

    def __init__(
        self,
        camera: Camera,
        *,
        engine: str = "raycast",
        light: Light = DEFAULT_LIGHT,
        supersample: int = 2,
        smooth_cells: int = SMOOTH_CELLS,
    ) -> None:
        if not 1 <= supersample <= 8:
            raise InputError(f"supersampling {supersample} must be from 1 to 8", code="supersample")
        self.camera = camera
        self.engine = ShadeEngine.parse(engine)
        self.light = light
        self.supersample = supersample
        self.smooth_cells = smooth_cells
        self._fine = camera.scaled(supersample)
        if self.engine is ShadeEngine.FILAMENT:
            from renderer.filament import check_filament_camera, filament_process

            check_filament_camera(self._fine)
            filament_process().start(self._fine.width, self._fine.height)

    def render(
        self,
        vertices: ArrayLike,
        triangles: ArrayLike,
        uv: ArrayLike | None,
        camera_from_panel: ArrayLike,
        inclination_deg: float = 0.0,
    ) -> NDArray[np.uint8]:
        """Grey picture of a drape.

        Args:
            vertices: [m], panel frame, shape [V, 3].
            triangles: int, shape [T, 3].
            uv: texture coordinates, shape [V, 2]. Those of a regular grid (``GridMesh.uv``) have the surface between
                its vertices smoothed; with others, or None, the triangles are drawn as they are.
            camera_from_panel: pose, [4, 4].
            inclination_deg: positive brings the hem towards the camera [degree].

        Returns:
            uint8 [H, W], sRGB grey; background 0, cloth never 0 inside its outline.

        Raises:
            InputError: mesh or pose that cannot be rendered.
            DrapemeterError: ``picture_constant``: the picture shows nothing (cloth out of view, or a fault of the
                graphics driver).
        """
        pose = check_pose(camera_from_panel) @ inclination_pose(inclination_deg)
        if uv is not None and self.smooth_cells > 0 and grid_shape(uv) is not None:
            check_surface(vertices, triangles)
            surface = refine_grid(vertices, uv, self.smooth_cells)
            vertices, triangles, uv = surface.vertices, surface.triangles, surface.uv
        if self.engine is ShadeEngine.FILAMENT:
            from renderer.filament import filament_radiance

            linear = filament_radiance(vertices, triangles, uv, self._fine, pose, self.light)
        else:
            linear = _raycast_radiance(vertices, triangles, self._fine, pose, self.light)
        picture = encode_srgb(_average(linear, self.supersample))
        if picture.min() == picture.max():
            raise DrapemeterError(
                f"the shaded picture is constant ({picture.min()}): the cloth is out of view or fills it evenly, or "
                f"the {self.engine} engine failed; check camera_from_panel, else restart the worker",
                code="picture_constant",
            )
        return picture


def shade_lambertian_raycast(
    vertices: ArrayLike,
    triangles: ArrayLike,
    camera: Camera,
    camera_from_panel: ArrayLike,
    *,
    uv: ArrayLike | None = None,
    inclination_deg: float = 0.0,
    light: Light = DEFAULT_LIGHT,
    supersample: int = 2,
) -> NDArray[np.uint8]:
    """Shaded picture by ray casting alone: no graphics driver, bit-identical between runs; uint8 [H, W].

    What tests hold against closed forms: Lambert's law, the place of the light.

    Arguments and errors as for :class:`ShadedRenderer` and its ``render``.
    """
    renderer = ShadedRenderer(camera, engine=ShadeEngine.RAYCAST, light=light, supersample=supersample)
    return renderer.render(vertices, triangles, uv, camera_from_panel, inclination_deg)


def _raycast_radiance(
    vertices: ArrayLike, triangles: ArrayLike, camera: Camera, pose: NDArray[np.float64], light: Light
) -> NDArray[np.float64]:
    """Linear radiance, float64 [H, W]; 0 where there is no cloth."""
    scene = RayScene(vertices, triangles)
    hits = scene.cast(camera, pose)
    seen = hits.triangle != NO_TRIANGLE
    radiance = np.zeros(seen.shape)
    radiance[seen] = light.radiance(hit_normals(scene, hits, camera, pose)[seen])
    return radiance


def _average(linear: NDArray[np.float64], factor: int) -> NDArray[np.float64]:
    """Mean of each block of ``factor`` x ``factor`` samples."""
    height, width = linear.shape
    mean: NDArray[np.float64] = linear.reshape(height // factor, factor, width // factor, factor).mean(axis=(1, 3))
    return mean
