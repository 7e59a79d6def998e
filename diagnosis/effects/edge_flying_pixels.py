"""Pixels at depth edges mix both sides."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Share of the edge pixels that the sensor reads otherwise without mixing."""
    known = scene.sensor.flying_pixels
    return scene.with_sensor(flying_pixels=known + size[SCALAR] * (1.0 - known))


EFFECT = Effect(
    name="edge_flying_pixels",
    stage=Stage.SENSOR,
    unit="1",
    components=scalar(0.2, 0.9, most=1.0),
    summary="A share of the pixels at depth edges reads between the two sides.",
    hook="sensor.flying_pixels",
    source="Mixed pixels of depth cameras.",
    change=change,
    white=True,
    share=True,
)
