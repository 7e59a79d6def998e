"""The bottom right corner of the stretch scene is pulled farther or less."""

from __future__ import annotations

import math

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene
from simcore.scenes import Scene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Along the sample's diagonal, as the scene pulls; the hanging scene has no such pin."""
    if scene.setup.scene is not Scene.STRETCH:
        return scene
    x, y, z = scene.setup.pins_m["bottom_right"]
    width, height = (side / max(scene.setup.sample_size_m) for side in scene.setup.sample_size_m)
    step = size[SCALAR] / math.hypot(width, height)
    return scene.with_setup(scene.setup.with_pins(bottom_right=(x + step * width, y - step * height, z)))


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
