"""Pixels at depth edges mix both sides."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Share of edge pixels."""
    return scene.with_sensor(flying_pixels=size[SCALAR])


EFFECT = Effect(
    name="edge_flying_pixels",
    stage=Stage.SENSOR,
    unit="1",
    components=scalar(0.2, 0.9),
    summary="A share of the pixels at depth edges reads between the two sides.",
    hook="sensor.flying_pixels",
    source="Mixed pixels of depth cameras.",
    change=change,
    white=True,
)
