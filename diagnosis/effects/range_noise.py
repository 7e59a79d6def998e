"""The sensor is noisier than stated."""

from __future__ import annotations

import math

from diagnosis.effect import SCALAR, Effect, Size, Stage, not_negative, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Variances add; at the sensor's reference distance."""
    total = math.hypot(scene.sensor.range_noise_m, not_negative("range_noise", size[SCALAR]))
    return scene.with_sensor(range_noise_m=total)


EFFECT = Effect(
    name="range_noise",
    stage=Stage.SENSOR,
    unit="m",
    components=scalar(0.001, 0.004),
    summary="More white noise along z than stated; independent of the stated noise.",
    hook="sensor.range_noise_m",
    source="Depth noise of triangulation, grows as z squared.",
    change=change,
    white=True,
)
