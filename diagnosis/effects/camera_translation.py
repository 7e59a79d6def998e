"""The camera stands beside its stated place."""

from __future__ import annotations

from diagnosis.effect import Effect, Size, Stage, vector
from diagnosis.scene import SimulationScene
from renderer.pose import pose_from_rotation


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """A shift of the panel in the camera frame."""
    shift = pose_from_rotation(translation=[size[name] for name in ("tx", "ty", "tz")])
    return scene.with_pose(shift @ scene.camera_from_panel)


EFFECT = Effect(
    name="camera_translation",
    stage=Stage.CAMERA,
    unit="m",
    components=vector(("tx", "ty", "tz"), 0.003, 0.012),
    summary="The panel is shifted in the camera frame (x right, y down, z forward).",
    hook="camera_from_panel",
    source="Tolerance of a tripod and of extrinsic calibration.",
    change=change,
    vector=True,
)
