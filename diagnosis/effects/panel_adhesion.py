"""The cloth sticks to the panel."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """A pull within some millimetres."""
    return scene.with_mechanics(adhesion_pa=scene.mechanics.adhesion_pa + size[SCALAR])


EFFECT = Effect(
    name="panel_adhesion",
    stage=Stage.ENVIRONMENT,
    unit="Pa",
    components=scalar(0.7, 5.0),
    summary="Static charge or moisture pulls cloth within a few millimetres to the panel.",
    hook="mechanics.adhesion_pa",
    source="Electrostatic pressure of charged textiles.",
    change=change,
    presses=1,
)
