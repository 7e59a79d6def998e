"""The sensor or its driver smooths the picture."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Variances of blurs add."""
    return scene.with_sensor(smoothing_px=(scene.sensor.smoothing_px**2 + size[SCALAR] ** 2) ** 0.5)


EFFECT = Effect(
    name="sensor_smoothing",
    stage=Stage.SENSOR,
    unit="px",
    components=scalar(0.6, 2.5),
    summary="The depth picture is blurred by a Gaussian of this standard deviation.",
    hook="sensor.smoothing_px",
    source="Spatial filters of depth camera drivers.",
    change=change,
)
