"""The sensor rounds depths more coarsely than stated."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, not_negative, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """The coarser step rules."""
    step = not_negative("quantisation", size[SCALAR])
    return scene.with_sensor(quantisation_m=max(scene.sensor.quantisation_m, step))


EFFECT = Effect(
    name="quantisation",
    stage=Stage.SENSOR,
    unit="m",
    components=scalar(0.001, 0.005),
    summary="Depths come in steps of this size.",
    hook="sensor.quantisation_m",
    source="Disparity steps of stereo cameras.",
    change=change,
    white=True,
    vague=("log_noise",),  # as the panel lies on a step or between two of them
)
