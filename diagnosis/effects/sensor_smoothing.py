"""The sensor or its driver smooths the picture."""

from __future__ import annotations

import math

from diagnosis.effect import SCALAR, Effect, Size, Stage, not_negative, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Variances of blurs add; by the driver after the noise, or by the optics before it."""
    name = "filter_px" if size["after_noise"] > 0.5 else "smoothing_px"
    total = math.hypot(getattr(scene.sensor, name), not_negative("sensor_smoothing", size[SCALAR]))
    return scene.with_sensor(**{name: total})


EFFECT = Effect(
    name="sensor_smoothing",
    stage=Stage.SENSOR,
    unit="px",
    components=scalar(0.6, 2.5),
    summary="The depth picture is blurred by a Gaussian of this standard deviation.",
    hook="sensor.filter_px, sensor.smoothing_px",
    source="Spatial filters of depth camera drivers.",
    change=change,
    places=({"after_noise": 1.0}, {"after_noise": 0.0}),
    where="`after_noise` 1: a filter blurs the noise, too; 0: the optics blur what is there before the noise",
)
