"""The camera is turned against its stated pose."""

from __future__ import annotations

import math

from diagnosis.effect import Effect, Size, Stage, vector
from diagnosis.scene import SimulationScene
from renderer.pose import pose_from_rotation


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """A rotation vector in the camera frame, applied after the stated pose."""
    turn = pose_from_rotation([math.radians(size[name]) for name in ("rx", "ry", "rz")])
    return scene.with_pose(turn @ scene.camera_from_panel)


EFFECT = Effect(
    name="camera_rotation",
    stage=Stage.CAMERA,
    unit="deg",
    components=vector(("rx", "ry", "rz"), 0.5, 2.0),
    summary="What is seen turns about the camera's axes (x right, y down, z forward), as if the camera turned back.",
    hook="camera_from_panel",
    source="Tolerance of a tripod head and of extrinsic calibration.",
    change=change,
    vector=True,
)
