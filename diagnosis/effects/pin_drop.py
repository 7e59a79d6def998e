"""One top pin is lower than the other."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Positive lowers the right pin, negative the left one."""
    name = "top_right" if size[SCALAR] >= 0.0 else "top_left"
    x, y, z = scene.setup.pins_m[name]
    return scene.with_setup(scene.setup.with_pins(**{name: (x, y - abs(size[SCALAR]), z)}))


EFFECT = Effect(
    name="pin_drop",
    stage=Stage.SETUP,
    unit="m",
    components=scalar(0.003, 0.012, signed=True),
    summary="The right top pin (negative: the left) is lower than stated.",
    hook="setup.pins_m",
    source="Placing magnets by hand and rule.",
    change=change,
)
