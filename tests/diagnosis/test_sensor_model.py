"""One sensor, however its noise is stated."""

from __future__ import annotations

import numpy as np
import pytest

from capture.documents import SensorDocument
from diagnosis.tasks.sensors import sensor_model, usual_distance
from renderer.sensor import SensorModel


def test_the_same_noise_is_the_same_sensor_whatever_distance_it_is_stated_at() -> None:
    """Noise grows as z squared: a data sheet may go by any distance."""
    for at_m in (0.4, 0.9, 2.0, None):
        noise = 0.001 * ((at_m or 0.9) / 0.9) ** 2
        stated = SensorDocument(range_noise_m=noise, at_m=at_m)
        found = sensor_model(stated, 0.0001, 0.9, 0.9)
        assert found.at_m == 0.9 and found.range_noise_m == pytest.approx(0.001, rel=1e-12)
    exact = sensor_model(SensorDocument(range_noise_m=0.001, at_m=0.9, quantisation_m=0.0002), 0.0001, 0.9, 0.9)
    assert exact == SensorModel(range_noise_m=0.001, at_m=0.9, quantisation_m=0.0002)
    assert sensor_model(None, 0.0001, 1.2, 1.1) == SensorModel()


def test_captures_from_two_distances_have_one_sensor() -> None:
    """What is found of its noise is then one size, which grows with each capture's own distance."""
    stated = SensorDocument(range_noise_m=0.001, at_m=0.9)
    near, far = (sensor_model(stated, 0.0001, panel_m, 1.0) for panel_m in (0.9, 1.1))
    assert near == far and near.at_m == 1.0
    assert near.range_noise_m == pytest.approx(0.001 * (1.0 / 0.9) ** 2)


def test_the_usual_distance_is_that_of_most() -> None:
    poses = [np.eye(4) for _ in range(3)]
    for pose, z in zip(poses, (0.9, 1.0, 3.0), strict=True):
        pose[2, 3] = z
    assert usual_distance(poses) == 1.0
