"""Open3D's offscreen renderer (Filament on Vulkan), guarded against its known faults.

* One renderer a process, kept: memory grows with each one created. It works only on the thread that created it.
* After 131,042 renders a process gives blank pictures without an error (Open3D issue 6912): the process is to be
  recycled before, and says so.
* Without a Vulkan device Filament aborts the process: a child process tries first.
* Meshes get triangle UVs: without them they are drawn corrupt under software Vulkan.
* It prints to standard output from C++: that is sent to standard error.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.camera import Camera
from renderer.light import Light
from renderer.surface import check_surface, vertex_normals
from simcore.errors import DrapemeterError, InputError, MissingResourceError

MAX_RENDERS_PER_PROCESS = 100_000
_PIXEL_CENTRE = 0.5
"""Filament's pixel centres lie at halves, OpenCV's at whole numbers."""
_FULL_LUX = 2.37e5
"""Illuminance that shows a white face square to the light at 251 of 255 (Open3D's fixed exposure, no tone mapping)."""
_FULL_COUNT = 251.0
_BACKGROUND = (0.0, 0.0, 1.0, 1.0)
"""Blue, so that black cloth and background differ."""
_PROBE = "import open3d; open3d.visualization.rendering.OffscreenRenderer(16, 16).render_to_image(); print('ready')"
_PROBE_SECONDS = 120


@cache
def probe_filament() -> None:
    """Draw one picture in a child process, once: a machine without Vulkan kills that process instead of this one.

    Raises:
        MissingResourceError: no picture came.
    """
    try:
        child = subprocess.run([sys.executable, "-c", _PROBE], capture_output=True, text=True, timeout=_PROBE_SECONDS)
        reason = (child.stderr.strip().splitlines() or [f"exit status {child.returncode}"])[-1]
        if child.returncode == 0 and "ready" in child.stdout:
            return
    except subprocess.TimeoutExpired:
        reason = f"no picture within {_PROBE_SECONDS} s"
    raise MissingResourceError(
        f"Open3D's offscreen renderer does not run here ({reason}): install libvulkan1 and mesa-vulkan-drivers, "
        "or choose engine 'raycast'",
        code="vulkan_missing",
    )


def check_filament_camera(camera: Camera) -> None:
    """Refuse a camera that Filament cannot imitate.

    Raises:
        InputError: the camera has lens distortion.
    """
    if camera.distorted:
        raise InputError(
            "the filament engine draws no lens distortion: choose engine 'raycast' for this camera", code="distortion"
        )


def filament_radiance(
    vertices: ArrayLike,
    triangles: ArrayLike,
    uv: ArrayLike | None,
    camera: Camera,
    camera_from_panel: NDArray[np.float64],
    light: Light,
) -> NDArray[np.float64]:
    """Linear radiance of the cloth, float64 [H, W]; 0 where there is none.

    Raises:
        InputError: the mesh cannot be rendered.
        DrapemeterError: called from another thread, or the process has drawn too many pictures.
    """
    v, t = check_surface(vertices, triangles)
    return _Filament.of_this_process(camera.width, camera.height).radiance(v, t, uv, camera, camera_from_panel, light)


class _Filament:
    """The process's one offscreen renderer."""

    _only: _Filament | None = None
    _renders = 0

    def __init__(self, width: int, height: int) -> None:
        import open3d as o3d

        self._o3d: Any = o3d
        self.size = (width, height)
        self.thread = threading.get_ident()
        self._lit = False
        with _stdout_to_stderr():
            self._renderer: Any = o3d.visualization.rendering.OffscreenRenderer(width, height)
            self._prepare_view()
            self._renderer.render_to_image()

    @classmethod
    def of_this_process(cls, width: int, height: int) -> _Filament:
        if cls._only is not None and cls._only.thread != threading.get_ident():
            raise DrapemeterError(
                "the offscreen renderer works only on the thread that created it: keep one rendering thread, "
                "or choose engine 'raycast'",
                code="renderer_thread",
            )
        if cls._renders >= MAX_RENDERS_PER_PROCESS:
            raise DrapemeterError(
                f"this process has drawn {cls._renders} pictures; Open3D's go blank after 131,042: restart the worker",
                code="renderer_worn_out",
            )
        if cls._only is None or cls._only.size != (width, height):
            cls._only = None  # free the old one first
            cls._only = cls(width, height)
        return cls._only

    def _prepare_view(self) -> None:
        scene = self._renderer.scene
        scene.set_background(_BACKGROUND)
        scene.view.set_post_processing(False)  # linear light: no tone mapping, no dithering
        scene.view.set_antialiasing(False)
        scene.view.set_sample_count(1)
        scene.scene.enable_indirect_light(False)
        scene.scene.enable_sun_light(False)

    def radiance(
        self,
        vertices: NDArray[np.float64],
        triangles: NDArray[np.int32],
        uv: ArrayLike | None,
        camera: Camera,
        camera_from_panel: NDArray[np.float64],
        light: Light,
    ) -> NDArray[np.float64]:
        scene = self._renderer.scene
        scene.clear_geometry()
        if self._lit:
            scene.scene.remove_light("key")
        scene.add_geometry("cloth", self._mesh(vertices, triangles, uv), self._material())
        ray = -(camera_from_panel[:3, :3].T @ light.towards)
        scene.scene.add_directional_light("key", [1.0, 1.0, 1.0], ray.astype(np.float32), _FULL_LUX, False)
        self._lit = True
        matrix = camera.matrix
        matrix[:2, 2] += _PIXEL_CENTRE
        self._renderer.setup_camera(matrix, camera_from_panel, camera.width, camera.height)
        picture = np.asarray(self._renderer.render_to_image())
        type(self)._renders += 1
        cloth = picture[..., 0] == picture[..., 2]
        facing = picture[..., 0].astype(np.float64) / _FULL_COUNT
        return np.where(cloth, light.albedo * (light.ambient + light.direct * facing), 0.0)

    def _mesh(self, vertices: NDArray[np.float64], triangles: NDArray[np.int32], uv: ArrayLike | None) -> Any:
        geometry, utility = self._o3d.geometry, self._o3d.utility
        mesh = geometry.TriangleMesh(utility.Vector3dVector(vertices), utility.Vector3iVector(triangles))
        mesh.vertex_normals = utility.Vector3dVector(vertex_normals(vertices, triangles))
        coordinates = np.zeros((len(vertices), 2)) if uv is None else np.asarray(uv, dtype=np.float64)
        if coordinates.shape != (len(vertices), 2):
            raise InputError(f"uv must have shape [{len(vertices)}, 2], got {coordinates.shape}", code="mesh_shape")
        mesh.triangle_uvs = utility.Vector2dVector(coordinates[triangles].reshape(-1, 2))
        return mesh

    def _material(self) -> Any:
        material = self._o3d.visualization.rendering.MaterialRecord()
        material.shader = "defaultLit"
        material.base_color = [1.0, 1.0, 1.0, 1.0]
        material.base_roughness, material.base_reflectance, material.base_metallic = 1.0, 0.0, 0.0
        return material


@contextmanager
def _stdout_to_stderr() -> Iterator[None]:
    """Send what Open3D and Filament write to standard output, through Python or past it, to standard error."""
    sys.stdout.flush()
    saved = os.dup(1)
    try:
        os.dup2(2, 1)
        with redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
