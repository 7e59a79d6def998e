"""The sensor reads all depths too long or too short by a share."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Times what the sensor already does."""
    return scene.with_sensor(depth_scale=(1.0 + scene.sensor.depth_scale) * (1.0 + size[SCALAR]) - 1.0)


EFFECT = Effect(
    name="depth_scale",
    stage=Stage.SENSOR,
    unit="1",
    components=scalar(0.006, 0.03, signed=True),
    summary="All depths are too long (positive) or too short by a share.",
    hook="sensor.depth_scale",
    source="Baseline and focal length errors of triangulation.",
    change=change,
    share=True,
)
