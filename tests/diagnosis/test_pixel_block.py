"""What all captures of a set share, measured on captures made up for it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.effects import get_effect
from diagnosis.inference.block import PixelBlock, make_pixel_block, median_of_known
from diagnosis.inference.likelihood import LikelihoodModel, pixel_log_likelihood, pixel_unknown, some_off
from diagnosis.inference.noise import NoiseModel
from diagnosis.inference.subtract import pixels_without
from diagnosis.measurement.pixel_statistics import PIXEL_NAMES
from diagnosis.measurement.reference import PLANE_NAMES
from diagnosis.simulation.sizes import nodes

PIXELS, PLANE = len(PIXEL_NAMES), len(PLANE_NAMES)


def capture(
    scene: str, pixels: float, plane_m: float = 0.0, *, sensor_known: bool = True, beside: dict[Any, Any] | None = None
) -> Any:
    """One whose statistics all differ by ``pixels`` from the stated sensor's, and the panel's place by ``plane_m``."""
    measured = SimpleNamespace(pixels=np.full(PIXELS, pixels), plane=np.full(PLANE, plane_m))
    responses = SimpleNamespace(
        sensed=np.zeros(PIXELS),
        effects={"dropout": (np.zeros((1, 4 + PLANE)), np.full((1, PIXELS), pixels))},
        beside=beside or {},
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


def test_what_the_sensor_does_with_two_effects_counts_where_all_of_stretch_was_rendered_with_both() -> None:
    both = ("dropout", "range_noise")
    rows = {both: (np.zeros((1, 4 + PLANE)), np.full((1, PIXELS), 0.7))}
    folds, seen = capture("hanging", 0.1), [capture("stretch", 0.1, beside=rows) for _ in range(2)]
    block = make_pixel_block([folds, *seen], NoiseModel())
    np.testing.assert_allclose(block.beside[both][0, :PIXELS], 7.0 * block.responses["dropout"][0, :PIXELS])
    assert make_pixel_block([folds, seen[0], capture("stretch", 0.1)], NoiseModel()).beside == {}


def test_the_noise_that_coarse_steps_give_depends_on_where_the_panel_lies() -> None:
    model = LikelihoodModel()
    measured = np.array([30.0, 20.0])
    rows = {"quantisation": np.array([[0.0, 19.0], [25.0, 20.0]]), "range_noise": np.array([[30.0, 0.0], [35.0, 0.0]])}
    block = PixelBlock(measured, rows, sensor_known=True, names=("log_noise", "log_step"))
    np.testing.assert_array_equal(block.vagueness("quantisation"), [25.0, 0.0])
    np.testing.assert_array_equal(block.vagueness("range_noise"), [0.0, 0.0])
    every = np.ones((len(nodes(get_effect("quantisation"))), 1)) * rows["quantisation"][1]
    left = pixels_without(replace(block, responses={"quantisation": every}), "quantisation", {"magnitude": 0.003})
    np.testing.assert_array_equal(left.vague, [625.0, 0.0])
    coarse = rows["quantisation"][:1]
    vague = pixel_log_likelihood(block, coarse, model, block.vagueness("quantisation"))
    noisy = pixel_log_likelihood(block, rows["range_noise"][:1], model, block.vagueness("range_noise"))
    assert vague[0] > noisy[0] > pixel_log_likelihood(block, coarse, model)[0]


def test_numbers_that_an_effect_was_taken_away_from_stay_as_uncertain_as_its_response() -> None:
    size = {"magnitude": 0.04}
    count = len(nodes(get_effect("dropout")))
    rows = {"dropout": np.tile([50.0, 0.0], (count, 1))}
    left = pixels_without(PixelBlock(np.array([54.0, 0.0]), rows, sensor_known=True), "dropout", size)
    np.testing.assert_allclose(left.measured, [4.0, 0.0])
    exact = PixelBlock(left.measured, rows, sensor_known=True)
    calm = np.zeros((1, 2))
    model = LikelihoodModel()
    assert pixel_log_likelihood(left, calm, model)[0] > pixel_log_likelihood(exact, calm, model)[0] + 2.0
    gained = [pixel_unknown(b, model) - pixel_log_likelihood(b, calm, model)[0] for b in (left, exact)]
    assert gained[0] < gained[1]


def test_one_number_that_is_far_off_among_many_is_something_and_none_is_nothing() -> None:
    model, calm = LikelihoodModel(), np.zeros(10)
    off = np.concatenate([calm[1:], [8.0]])

    def gained(measured: np.ndarray, among: np.ndarray | None = None) -> float:
        return some_off(PixelBlock(measured, {}, sensor_known=True), model, among)

    assert gained(calm) < -2.0
    assert gained(calm) < gained(0.5 + calm) < gained(off)
    assert gained(off) > 2.0
    assert gained(off, off > 0.0) > gained(off)  # the fewer might be off, the less that one of them is needs
    assert gained(off, off < 0.0) == 0.0 == gained(np.zeros(0))


@pytest.mark.parametrize("shape", [(1, 3), (4, 9), (5, 9), (16, 7, 10)])
def test_median_of_what_is_known_is_numpys_to_the_last_bit(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(len(shape) * shape[0])
    values = rng.standard_normal(shape)
    values[rng.random(shape) < 0.3] = np.nan
    values[..., 0] = np.nan
    with pytest.warns(RuntimeWarning, match="All-NaN"):
        expected = np.nanmedian(values, axis=0)
    np.testing.assert_array_equal(median_of_known(values), expected)
