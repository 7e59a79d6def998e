"""The sample was cut at an angle to the yarns."""

from __future__ import annotations

import math

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """The material's axes turned in the sample."""
    return scene.with_mechanics(off_grain_rad=scene.mechanics.off_grain_rad + math.radians(size[SCALAR]))


EFFECT = Effect(
    name="off_grain",
    stage=Stage.FABRIC,
    unit="deg",
    components=scalar(4.0, 15.0, signed=True),
    summary="The yarns are turned against the edges of the sample.",
    hook="mechanics.off_grain_rad",
    source="Bow and skew of fabrics, ASTM D3882.",
    change=change,
)
