"""Readings are missing."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Share of the pixels that the sensor reads otherwise, scattered."""
    known = scene.sensor.dropout
    return scene.with_sensor(dropout=known + size[SCALAR] * (1.0 - known))


EFFECT = Effect(
    name="dropout",
    stage=Stage.SENSOR,
    unit="1",
    components=scalar(0.01, 0.10, most=1.0),
    summary="A share of the pixels has no data.",
    hook="sensor.dropout",
    source="Confidence thresholds of depth cameras.",
    change=change,
    white=True,
    share=True,
)
