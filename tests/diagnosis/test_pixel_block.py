"""What all captures of a set share, measured on captures made up for it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.block import make_pixel_block
from diagnosis.features import PLANE_NAMES
from diagnosis.noise import NoiseModel
from diagnosis.pixel_statistics import PIXEL_NAMES

PIXELS, PLANE = len(PIXEL_NAMES), len(PLANE_NAMES)


def capture(scene: str, pixels: float, plane_m: float = 0.0, *, sensor_known: bool = True) -> Any:
    """One whose statistics all differ by ``pixels`` from the stated sensor's, and the panel's place by ``plane_m``."""
    measured = SimpleNamespace(pixels=np.full(PIXELS, pixels), plane=np.full(PLANE, plane_m))
    responses = SimpleNamespace(
        sensed=np.zeros(PIXELS), effects={"dropout": (np.zeros((1, 4 + PLANE)), np.full((1, PIXELS), pixels))}
    )
    return SimpleNamespace(
        scene=scene, measured=measured, responses=responses, sensor_known=sensor_known, pose_known=True
    )


def test_pixels_across_folds_that_fell_elsewhere_say_nothing_where_stretch_was_captured() -> None:
    model = NoiseModel()
    folds = [capture("hanging", 0.8, 0.002) for _ in range(4)]
    block = make_pixel_block([*folds, *(capture("stretch", 0.02, 0.002) for _ in range(2))], model)
    scale = np.array(model.pixel_sigma) * np.sqrt(1 + 1 / 2)
    np.testing.assert_allclose(block.measured[:PIXELS], 0.02 / scale)
    np.testing.assert_allclose(block.responses["dropout"][0, :PIXELS], 0.02 / scale)
    np.testing.assert_allclose(block.measured[PIXELS:], 0.002 / (model.plane_m * np.sqrt(1 + 1 / 6)))
    alone = make_pixel_block(folds, model)
    np.testing.assert_allclose(alone.measured[:PIXELS], 0.8 / (np.array(model.pixel_sigma) * np.sqrt(1 + 1 / 4)))


@pytest.mark.parametrize("scenes", [("hanging",), ("hanging", "stretch")])
def test_without_a_stated_sensor_there_are_no_pixel_statistics(scenes: tuple[str, ...]) -> None:
    block = make_pixel_block([capture(scene, 0.5, sensor_known=False) for scene in scenes], NoiseModel())
    assert block.measured.shape == (PLANE,) and not block.sensor_known
