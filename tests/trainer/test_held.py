"""What is said of magnets goes by what the network learnt from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from capture.normalise import NetworkInput, held_otherwise
from simcore.scenes import Scene
from trainer.held import held_in_training


@pytest.mark.parametrize(
    ("configuration", "held"),
    [
        ({}, (0.01,)),
        ({"pin_radius_m": None}, (0.01,)),
        ({"pin_radius_m": 0.03}, (0.03,)),
        ({"merged": [{"pin_radius_m": 0.03}, {"pin_radius_m": None}, {}]}, (0.01, 0.03)),
    ],
)
def test_a_store_says_how_magnets_held(configuration: dict[str, Any], held: tuple[float, ...]) -> None:
    assert held_in_training({"data": {"configuration": configuration}}) == held
    assert held_in_training({}) == (0.01,)


def test_what_the_models_before_learnt_from_counts_too() -> None:
    first = {"data": {"configuration": {"pin_radius_m": 0.03}}}
    second = {"data": {"configuration": {}}, "start": {"model_version": "a", "provenance": first}}
    third = {"data": {"configuration": {"pin_radius_m": 0.02}}, "start": {"model_version": "b", "provenance": second}}
    assert held_in_training(second) == (0.01, 0.03)
    assert held_in_training(third) == (0.01, 0.02, 0.03)


def test_captures_are_held_as_what_was_learnt_from() -> None:
    picture = np.zeros((256, 256), np.float32)
    shown = NetworkInput(picture, picture > 0, Scene.STRETCH, 2.0, pin_radius_m=0.03)
    assert held_otherwise(shown, (0.03,)) is None and held_otherwise(shown, (0.01, 0.03)) is None
    assert held_otherwise(shown, (0.01,)) == "magnets hold 60 mm round a corner, not 20"
    nominal = NetworkInput(picture, picture > 0, Scene.STRETCH)
    assert held_otherwise(nominal, (0.01,)) is None and held_otherwise(nominal, (0.03,)) is not None
