"""The panel is not upright."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import SCALAR, Effect, Size, Stage, Twin, scalar
from diagnosis.scene import SimulationScene
from simcore.errors import InputError
from simcore.scenes import GRAVITY_M_S2

MOST_DEG = 90.0
"""A panel that lies on its back or its face."""


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Gravity turned in the panel frame: positive, it leans back and the cloth is pressed to it."""
    if not abs(size[SCALAR]) <= MOST_DEG:
        raise InputError(
            f"panel_tilt {size[SCALAR]:g} is out of range: give degrees from -{MOST_DEG:g} to {MOST_DEG:g}",
            code="effect_magnitude",
        )
    gx, gy, gz = scene.mechanics.gravity
    angle = math.radians(size[SCALAR])
    cosine, sine = math.cos(angle), math.sin(angle)
    return scene.with_mechanics(gravity=(gx, cosine * gy - sine * gz, sine * gy + cosine * gz))


def as_draft(tilt: NDArray[np.float64], density: float) -> NDArray[np.float64]:
    """Pressure of a draft [Pa] that does what gravity does across a tilted panel [deg]."""
    return np.asarray(-density * GRAVITY_M_S2 * np.sin(np.radians(tilt)))


EFFECT = Effect(
    name="panel_tilt",
    stage=Stage.SETUP,
    unit="deg",
    components=scalar(6.0, 14.0, signed=True),
    summary="The panel leans back (positive: gravity presses the cloth to it) or forward.",
    hook="mechanics.gravity",
    source="A panel set up without a level.",
    change=change,
    presses=1,
    twin=Twin("air_draft", as_draft),
)
