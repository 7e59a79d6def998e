"""Distances of captures from states, compared without the sensor's noise."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from diagnosis.measurement.nearness import nearer, no_further
from diagnosis.measurement.picture import noise_square
from diagnosis.scene import SimulationScene
from renderer.sensor import SensorModel
from simcore.scenes import Setup


@pytest.fixture
def noisy() -> SimulationScene:
    scene = SimulationScene(Setup.nominal("stretch"))
    return replace(scene, sensor=SensorModel(range_noise_m=0.001, at_m=float(scene.camera_from_panel[2, 3])))


def seen(beyond_m: float, scene: SimulationScene) -> float:
    """As far as this and the noise together."""
    return math.hypot(beyond_m, math.sqrt(noise_square(scene)))


def test_noise_is_no_reason_to_be_further(noisy: SimulationScene) -> None:
    """A tenth and 0.1 mm more than 1.15 mm, 1 mm of it noise, is 1.23 mm; with a tenth of the noise it were 1.37."""
    assert noise_square(noisy) == pytest.approx(1e-6)
    assert no_further(seen(0.0005, noisy), noisy) == pytest.approx(seen(0.00065, noisy))
    assert no_further(0.00115, noisy) == pytest.approx(0.001235, abs=1e-6)
    silent = replace(noisy, sensor=SensorModel())
    assert no_further(0.0005, silent) == pytest.approx(0.00065)


def test_what_is_nearer_need_not_be_nearer_than_the_noise(noisy: SimulationScene) -> None:
    assert nearer(seen(0.0006, noisy), noisy) == pytest.approx(seen(0.00047, noisy))
    assert 0.001 < nearer(0.00123, noisy) < 0.00123
    silent = replace(noisy, sensor=SensorModel())
    assert nearer(0.0006, silent) == pytest.approx(0.00047)


def test_less_than_the_stated_noise_is_nearer_where_it_is_less_than_before(noisy: SimulationScene) -> None:
    assert nearer(0.0008, noisy) == 0.0008
    assert nearer(math.inf, noisy) == math.inf == no_further(math.inf, noisy)
    assert nearer(seen(0.00005, noisy), noisy) == pytest.approx(0.001)
