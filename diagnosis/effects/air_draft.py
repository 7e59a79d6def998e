"""A draft of air on the cloth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import SCALAR, Effect, Size, Stage, Twin, scalar
from diagnosis.scene import SimulationScene
from simcore.scenes import GRAVITY_M_S2

STEEPEST = 0.7
"""Sine of the largest tilt that a draft is held against."""


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """A uniform pressure."""
    return scene.with_mechanics(air_pressure_pa=scene.mechanics.air_pressure_pa + size[SCALAR])


def as_tilt(pressure: NDArray[np.float64], density: float) -> NDArray[np.float64]:
    """Tilt of the panel [deg] at which gravity presses the cloth to it as a draft does [Pa]."""
    sine = np.clip(-pressure / (density * GRAVITY_M_S2), -STEEPEST, STEEPEST)
    return np.asarray(np.degrees(np.arcsin(sine)))


EFFECT = Effect(
    name="air_draft",
    stage=Stage.ENVIRONMENT,
    unit="Pa",
    components=scalar(0.1, 0.5, signed=True),
    summary="Moving air lifts the cloth off the panel (positive) or presses it on.",
    hook="mechanics.air_pressure_pa",
    source="Dynamic pressure of air at 0.4 to 0.9 m/s, 1/2 rho v^2.",
    change=change,
    presses=-1,
    twin=Twin("panel_tilt", as_tilt),
)
