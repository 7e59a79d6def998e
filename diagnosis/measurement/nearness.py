"""How near is near: distances of captures from states, compared without the sensor's noise, which all of them hold."""

from __future__ import annotations

import math

from diagnosis.measurement.picture import noise_square
from diagnosis.scene import SimulationScene

NO_FURTHER, NO_FURTHER_M = 1.1, 0.0001
"""So much further, as a share and in metres, is as near as before."""
NEARER, NEARER_M = 0.95, 0.0001
"""So much nearer is nearer."""


def no_further(rms_m: float, scene: SimulationScene) -> float:
    """What counts as no further than a root mean square distance [m], the sensor's noise in both."""
    return _with_noise(NO_FURTHER * _beyond_noise(rms_m, scene) + NO_FURTHER_M, scene)


def nearer(rms_m: float, scene: SimulationScene) -> float:
    """Below what distance [m] a state is taken instead of one at a root mean square distance, the noise in both."""
    return min(rms_m, _with_noise(max(NEARER * _beyond_noise(rms_m, scene) - NEARER_M, 0.0), scene))


def _beyond_noise(rms_m: float, scene: SimulationScene) -> float:
    return math.sqrt(max(rms_m**2 - noise_square(scene), 0.0))


def _with_noise(beyond_m: float, scene: SimulationScene) -> float:
    return math.hypot(beyond_m, math.sqrt(noise_square(scene)))
