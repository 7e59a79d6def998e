"""The panel holds the cloth that touches it."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Coulomb friction."""
    return scene.with_mechanics(friction=scene.mechanics.friction + size[SCALAR])


EFFECT = Effect(
    name="panel_friction",
    stage=Stage.ENVIRONMENT,
    unit="1",
    components=scalar(0.2, 0.8),
    summary="Cloth that rests on the panel does not slide along it as freely as simulated.",
    hook="mechanics.friction",
    source="Textile on painted metal, 0.2 to 0.5.",
    change=change,
    holds=True,
)
