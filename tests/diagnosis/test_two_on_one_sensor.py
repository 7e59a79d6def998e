"""Two effects on one sensor are rendered together."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from diagnosis.afresh import together
from diagnosis.afresh.fresh import FreshLook
from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.pairs import Pair
from diagnosis.simulation.responses import Responses
from diagnosis.simulation.sizes import nodes
from diagnosis.tasks.fabric_task import CaptureResult
from tests.diagnosis.pair_parts import Capture, evidence


def test_two_effects_on_one_sensor_are_rendered_together_at_all_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps hide noise: what the second one changes beside the first is less than what it changes alone."""
    noise, steps = get_effect("range_noise"), get_effect("quantisation")

    def seen(depth: Any, sizes: Mapping[str, float], reference: Any) -> Any:
        value = sizes.get(noise.name, 0.0) * (0.2 if steps.name in sizes else 1.0) + 7.0 * sizes.get(steps.name, 0.0)
        return SimpleNamespace(vector=lambda: np.full(3, value), pixels=np.array([value]))

    monkeypatch.setattr(together, "sensed", seen)
    monkeypatch.setattr(together, "with_effects", lambda scene, sizes: {name: size[SCALAR] for name, size in sizes})
    rows = {
        effect.name: (np.zeros((len(nodes(effect)), 3)), factor * np.array([[s[SCALAR]] for s in nodes(effect)]))
        for effect, factor in ((noise, 1.0), (steps, 7.0))
    }
    responses = Responses(np.zeros((7, 3)), np.zeros((8, 3)), np.zeros(3), np.zeros(3), rows, np.zeros(1))
    look = cast(FreshLook, SimpleNamespace(scene_of=lambda capture: None))
    size = nodes(steps)[4]
    pair = Pair(steps.name, noise.name, {steps.name: size, noise.name: {SCALAR: 0.001}}, evidence(noise.name, 1.0))
    capture = cast(CaptureResult, Capture("seen", responses, SimpleNamespace(depth=None)))
    vectors, pixels = together.with_both(look, capture, [pair]).responses.beside[noise.name, steps.name]
    np.testing.assert_allclose(pixels[:, 0], [0.2 * s[SCALAR] for s in nodes(noise)], atol=1e-12)
    np.testing.assert_array_equal(vectors, 0.0)


def test_what_chance_does_to_cells_is_not_the_second_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mixed pixels move a cell's mean another way in every picture; a blur beside them moves it by its own alone."""
    stray, blur = get_effect("edge_flying_pixels"), get_effect("sensor_smoothing")

    def seen(depth: Any, sizes: Mapping[str, float], reference: Any) -> Any:
        value = 5.0 * sizes.get(stray.name, 0.0) + 2.0 * sizes.get(blur.name, 0.0)
        chance = 40.0 * sizes.get(stray.name, 0.0) * (-1.0 if blur.name in sizes else 1.0)  # another draw
        return SimpleNamespace(vector=lambda: np.full(3, value + chance), pixels=np.array([value]))

    monkeypatch.setattr(together, "sensed", seen)
    monkeypatch.setattr(together, "with_effects", lambda scene, sizes: {name: size[SCALAR] for name, size in sizes})
    rows = {
        effect.name: (
            np.full((len(nodes(effect)), 3), 0.0 if effect.white else 1.0),
            factor * np.array([[s[SCALAR]] for s in nodes(effect)]),
        )
        for effect, factor in ((stray, 5.0), (blur, 2.0))
    }
    responses = Responses(np.zeros((7, 3)), np.zeros((8, 3)), np.zeros(3), np.zeros(3), rows, np.zeros(1))
    look = cast(FreshLook, SimpleNamespace(scene_of=lambda capture: None))
    pair = Pair(
        stray.name, blur.name, {stray.name: nodes(stray)[4], blur.name: nodes(blur)[0]}, evidence(blur.name, 1.0)
    )
    capture = cast(CaptureResult, Capture("seen", responses, SimpleNamespace(depth=None)))
    vectors, pixels = together.with_both(look, capture, [pair]).responses.beside[blur.name, stray.name]
    np.testing.assert_array_equal(vectors, rows[blur.name][0])
    np.testing.assert_allclose(pixels[:, 0], [2.0 * s[SCALAR] for s in nodes(blur)], atol=1e-12)
