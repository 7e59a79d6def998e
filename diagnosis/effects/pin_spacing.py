"""The two top pins are farther apart or closer together than stated."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Half of the change to each side."""
    left, right = scene.setup.pins_m["top_left"], scene.setup.pins_m["top_right"]
    half = 0.5 * size[SCALAR]
    return scene.with_setup(
        scene.setup.with_pins(top_left=(left[0] - half, *left[1:]), top_right=(right[0] + half, *right[1:]))
    )


EFFECT = Effect(
    name="pin_spacing",
    stage=Stage.SETUP,
    unit="m",
    components=scalar(0.003, 0.010, signed=True),
    summary="The top pins are farther apart (positive) or closer than stated, half of it on each side.",
    hook="setup.pins_m",
    source="Placing magnets by hand and rule.",
    change=change,
)
