"""The focal length is not the stated one."""

from __future__ import annotations

from dataclasses import replace

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Both focal lengths by the same share."""
    factor = 1.0 + size[SCALAR]
    camera = replace(scene.camera, fx=scene.camera.fx * factor, fy=scene.camera.fy * factor)
    return replace(scene, camera=camera)


EFFECT = Effect(
    name="focal_scale",
    stage=Stage.CAMERA,
    unit="1",
    components=scalar(0.007, 0.03, signed=True),
    summary="The focal lengths are larger (positive) or smaller than stated, as a share.",
    hook="camera.fx, camera.fy",
    source="Spread of factory calibrations; drift with temperature.",
    change=change,
    share=True,
)
