"""Child process that draws with Open3D's offscreen renderer; started by :mod:`renderer.filament`, never imported by it.

Reads pickled :class:`~renderer.filament.DrawRequest` from standard input and answers each on what was standard output.
Filament and Open3D write there themselves, so both are moved: their words go to standard error.
"""

from __future__ import annotations

import os
import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.filament import DrawReply, DrawRequest
from renderer.surface import vertex_normals

_PIXEL_CENTRE = 0.5
"""Filament's pixel centres lie at halves, OpenCV's at whole numbers."""
_FULL_LUX = 2.37e5
"""Illuminance that shows a white face square to the light at 251 of 255 (Open3D's fixed exposure, no tone mapping)."""
_FULL_COUNT = 251.0
_BACKGROUND = (0.0, 0.0, 1.0, 1.0)
"""Blue, so that unlit cloth and background differ."""


class OffscreenCanvas:
    """One offscreen renderer, used by the thread that made it."""

    def __init__(self, width: int, height: int) -> None:
        import open3d as o3d

        self._o3d: Any = o3d
        self._renderer: Any = o3d.visualization.rendering.OffscreenRenderer(width, height)
        scene = self._renderer.scene
        scene.set_background(_BACKGROUND)
        scene.view.set_post_processing(False)  # linear light: no tone mapping, no dithering
        scene.view.set_antialiasing(False)
        scene.view.set_sample_count(1)
        scene.scene.enable_indirect_light(False)
        scene.scene.enable_sun_light(False)
        self._lit = False

    def draw(self, request: DrawRequest) -> NDArray[np.float32]:
        """Share of the direct light that the cloth sends back, float32 [H, W], from 0 to 1; NaN where there is none."""
        scene = self._renderer.scene
        scene.clear_geometry()
        if self._lit:
            scene.scene.remove_light("key")
        scene.add_geometry("cloth", self._mesh(request), self._material())
        ray = -(request.camera_from_panel[:3, :3].T @ request.towards_light)
        scene.scene.add_directional_light("key", [1.0, 1.0, 1.0], ray.astype(np.float32), _FULL_LUX, False)
        self._lit = True
        matrix = request.camera.matrix
        matrix[:2, 2] += _PIXEL_CENTRE
        self._renderer.setup_camera(matrix, request.camera_from_panel, request.camera.width, request.camera.height)
        picture = np.asarray(self._renderer.render_to_image())
        cloth = picture[..., 0] == picture[..., 2]
        return np.where(cloth, picture[..., 0] / np.float32(_FULL_COUNT), np.float32(np.nan))

    def _mesh(self, request: DrawRequest) -> Any:
        geometry, utility = self._o3d.geometry, self._o3d.utility
        mesh = geometry.TriangleMesh(
            utility.Vector3dVector(request.vertices), utility.Vector3iVector(request.triangles)
        )
        mesh.vertex_normals = utility.Vector3dVector(vertex_normals(request.vertices, request.triangles))
        # Without texture coordinates meshes are drawn corrupt under software Vulkan.
        mesh.triangle_uvs = utility.Vector2dVector(request.uv[request.triangles].reshape(-1, 2))
        return mesh

    def _material(self) -> Any:
        material = self._o3d.visualization.rendering.MaterialRecord()
        material.shader = "defaultLit"
        material.base_color = [1.0, 1.0, 1.0, 1.0]
        material.base_roughness, material.base_reflectance, material.base_metallic = 1.0, 0.0, 0.0
        return material


def resident_mb() -> float:
    """Resident memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def main(width: int, height: int) -> None:
    """Answer requests for pictures of one size until standard input closes; the first answer says "ready"."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    canvas = OffscreenCanvas(width, height)
    reply = DrawReply(None, resident_mb())
    while True:
        pickle.dump(reply, answers)
        answers.flush()
        try:
            request: DrawRequest = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        reply = DrawReply(canvas.draw(request), resident_mb())


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
