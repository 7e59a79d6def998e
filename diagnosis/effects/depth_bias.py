"""The sensor reads all depths too long or too short by a length."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Added to what the sensor already does."""
    return scene.with_sensor(depth_bias_m=scene.sensor.depth_bias_m + size[SCALAR])


EFFECT = Effect(
    name="depth_bias",
    stage=Stage.SENSOR,
    unit="m",
    components=scalar(0.003, 0.012, signed=True),
    summary="All depths are too long (positive) or too short by a length.",
    hook="sensor.depth_bias_m",
    source="Offset of depth cameras after warm-up.",
    change=change,
)
