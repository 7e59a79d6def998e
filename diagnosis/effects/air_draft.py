"""A draft of air on the cloth."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """A uniform pressure."""
    return scene.with_mechanics(air_pressure_pa=scene.mechanics.air_pressure_pa + size[SCALAR])


EFFECT = Effect(
    name="air_draft",
    stage=Stage.ENVIRONMENT,
    unit="Pa",
    components=scalar(0.1, 0.5, signed=True),
    summary="Moving air lifts the cloth off the panel (positive) or presses it on.",
    hook="mechanics.air_pressure_pa",
    source="Dynamic pressure of air at 0.4 to 0.9 m/s, 1/2 rho v^2.",
    change=change,
)
