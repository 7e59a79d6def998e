"""The bottom right corner of the stretch scene is pulled farther or less."""

from __future__ import annotations

import math

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene
from simcore.scenes import Scene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Along the outward diagonal; the hanging scene has no such pin."""
    if scene.setup.scene is not Scene.STRETCH:
        return scene
    x, y, z = scene.setup.pins_m["bottom_right"]
    step = size[SCALAR] / math.sqrt(2.0)
    return scene.with_setup(scene.setup.with_pins(bottom_right=(x + step, y - step, z)))


EFFECT = Effect(
    name="corner_pull",
    stage=Stage.SETUP,
    unit="m",
    components=scalar(0.003, 0.010, signed=True),
    summary="The bottom right corner is pulled farther (positive) or less along the diagonal, in stretch.",
    hook="setup.pins_m",
    source="Placing magnets by hand and rule.",
    change=change,
)
