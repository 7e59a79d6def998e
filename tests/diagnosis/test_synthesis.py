"""Capture sets whose drapes come from another simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from diagnosis.scene import SimulationScene
from diagnosis.synthesis import SET_CAMERA, SynthesisPlan, make_capture_set
from renderer.depth_png import read_depth_png
from simcore.drape import Drape, DrapeStatus
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters

HEIGHT_M, CAMERA_M = 0.1, 0.9


def test_another_simulator_drapes_every_capture_and_its_drapes_are_what_is_seen(tmp_path: Path) -> None:
    mesh, seeds = GridMesh(0.05), []

    def flat(fabric: FabricParameters, scene: SimulationScene, words: tuple[int, ...]) -> Drape:
        seeds.append((scene.setup.scene.value, words))
        u, v = mesh.material_coordinates.T
        vertices = np.stack([u - 0.25, -v, np.full(u.shape, HEIGHT_M)], axis=1)
        return Drape(mesh, vertices, DrapeStatus.STILL, 0.0, 0.0, True, 0, 0.0)

    made = make_capture_set(tmp_path, SynthesisPlan(fabrics=2, repeats=2, seed=3), draper=flat)
    assert len(seeds) == len(set(seeds)) == len(made.document.captures) == 8
    for capture in made.document.captures:
        depth = read_depth_png(tmp_path / capture.depth, SET_CAMERA.depth_unit_m)
        middle = depth[SET_CAMERA.height // 2 - 20 :, SET_CAMERA.width // 2 - 20 : SET_CAMERA.width // 2 + 20][:40]
        assert abs(float(np.median(middle)) - (CAMERA_M - HEIGHT_M)) < 1e-3
