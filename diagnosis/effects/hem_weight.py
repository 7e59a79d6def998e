"""The bottom edge is heavier than the rest."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Mass along the bottom edge."""
    return scene.with_mechanics(hem_kg_m=scene.mechanics.hem_kg_m + 1e-3 * size[SCALAR])


EFFECT = Effect(
    name="hem_weight",
    stage=Stage.FABRIC,
    unit="g/m",
    components=scalar(8.0, 50.0),
    summary="A sewn or rolled hem adds mass along the bottom edge.",
    hook="mechanics.hem_kg_m",
    source="A folded hem of 10 to 25 mm doubles or triples the fabric there.",
    change=change,
)
