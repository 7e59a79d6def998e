"""Pictures of drapes are rendered once and kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.measurement import picture as picture_module
from diagnosis.measurement.picture import picture_of
from diagnosis.scene import SimulationScene
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from simcore.drape import Drape, DrapeStatus
from simcore.mesh import GridMesh
from simcore.scenes import Setup


def drape_at(height_m: float) -> Drape:
    mesh = GridMesh(0.1)
    flat = np.column_stack([mesh.material_coordinates, np.full(mesh.vertex_count, height_m)])
    flat[:, :2] -= 0.25
    return Drape(mesh, flat, DrapeStatus.STILL, 1e-4, -0.1, True, 7, 0.1, "")


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Heights of what is rendered, with nothing kept beforehand."""
    heights: list[float] = []
    render = picture_module.render_depth

    def count(vertices: np.ndarray, *rest: object, **named: object) -> np.ndarray:
        heights.append(float(vertices[0, 2]))
        return render(vertices, *rest, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(picture_module, "render_depth", count)
    monkeypatch.setattr(picture_module, "_kept", picture_module._Kept())
    return heights


def test_the_same_drape_in_the_same_view_is_rendered_once(rendered: list[float]) -> None:
    scene = SimulationScene(Setup.nominal("stretch"))
    first = picture_of(drape_at(0.02), scene)
    np.testing.assert_array_equal(picture_of(drape_at(0.02), scene), first)
    assert rendered == [0.02]
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0] = 1.0


def test_another_height_camera_pose_or_no_panel_is_another_picture(rendered: list[float]) -> None:
    scene = SimulationScene(Setup.nominal("stretch"))
    pose = frontal_pose().copy()
    pose[2, 3] += 0.1
    others = [
        replace(scene, camera=replace(CANONICAL_CAMERA, fx=CANONICAL_CAMERA.fx * 1.1)),
        replace(scene, pose=tuple(map(tuple, pose.tolist()))),
        replace(scene, setup=replace(scene.setup, panel=False)),
    ]
    pictures = [picture_of(drape_at(height), scene) for height in (0.02, 0.03)]
    pictures += [picture_of(drape_at(0.02), other) for other in others]
    assert len(rendered) == len({picture.tobytes() for picture in pictures}) == 5


def test_what_was_not_asked_for_lately_is_given_up(rendered: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    scene = SimulationScene(Setup.nominal("stretch"))
    monkeypatch.setattr(picture_module, "KEPT_PIXELS", 2 * CANONICAL_CAMERA.width * CANONICAL_CAMERA.height)
    for height in (0.01, 0.02, 0.01, 0.03, 0.01, 0.02):
        picture_of(drape_at(height), scene)
    assert rendered == [0.01, 0.02, 0.03, 0.02]
