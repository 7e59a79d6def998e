"""How far magnets were off from repeat to repeat, from made-up repeats whose magnets were off by so much."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from diagnosis.inference.noise import NoiseModel
from diagnosis.inference.repeats import PIN_SCATTERS_M, SHARE, UNSEEN_PIN_M, pin_scatter
from diagnosis.measurement.features import Features
from diagnosis.measurement.reference import PLANE_NAMES
from tests.diagnosis.bare_capture import bare_capture

CELLS = 144
NOISE = NoiseModel()
LOG_NOISE, PIXELS = -7.0, 50.0
"""Of the pixels of each cell."""
RESPONSES = 0.3 * np.random.default_rng(0).standard_normal((6, CELLS + len(PLANE_NAMES)))
"""Of three magnets, each along x and y [m/m]."""


def repeat(
    moves_m: np.ndarray, errors_m: np.ndarray, scene: str = "stretch", fabric: str = "f1", state: int = 0
) -> Any:
    """A capture whose magnets were off by ``moves_m`` [6]; ``errors_m`` [cells + 3]: of its cells and plane."""
    vector = moves_m @ RESPONSES + errors_m
    made = bare_capture(0.001)
    made.scene, made.fabric, made.state = scene, fabric, state
    made.responses.pins = RESPONSES
    made.reference.slope = np.linspace(0.0, 0.5, CELLS)
    made.measured = Features(vector[:CELLS], vector[CELLS:], np.full(7, LOG_NOISE), np.full(CELLS, PIXELS))
    return made


def repeats(scatter_m: float, count: int = 6, seed: int = 1, errors: float = 1.0, **whose: Any) -> list[Any]:
    """Repeats with magnets off by ``scatter_m`` and errors ``errors`` times as large as the model says."""
    rng = np.random.default_rng(seed)
    slope = np.append(np.linspace(0.0, 0.5, CELLS), np.zeros(len(PLANE_NAMES)))
    sigma = np.sqrt(rest_of(NOISE, slope, np.append(np.full(CELLS, PIXELS), np.full(len(PLANE_NAMES), 1e3))))
    return [
        repeat(scatter_m * rng.standard_normal(6), errors * sigma * rng.standard_normal(len(sigma)), **whose)
        for _ in range(count)
    ]


def rest_of(noise: NoiseModel, slope: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Variance of a measurement by what else differs between repeats [m²]."""
    slide = (noise.slide_m * noise.repeat_share * slope) ** 2
    return np.asarray(noise.floor_m**2 + noise.repeat_m**2 + np.exp(2.0 * LOG_NOISE) / weight + slide + 1e-10)


def directly(captures: list[Any], noise: NoiseModel) -> float:
    """The same from whole covariances of the differences: their square counts in part, their determinant in full."""
    scores = np.zeros(len(PIN_SCATTERS_M))
    for number, first in enumerate(captures):
        for second in captures[number + 1 :]:
            apart = first.measured.vector() - second.measured.vector()
            slope = np.append(first.reference.slope, np.zeros(len(PLANE_NAMES)))
            rest = rest_of(noise, slope, np.append(first.measured.weight, np.full(len(PLANE_NAMES), 1e3)))
            for place, scatter in enumerate(PIN_SCATTERS_M):
                whole = 2.0 * (np.diag(rest) + scatter**2 * RESPONSES.T @ RESPONSES)
                scores[place] -= 0.5 * SHARE * float(apart @ np.linalg.solve(whole, apart))
                scores[place] -= 0.5 * float(np.linalg.slogdet(whole)[1])
    return PIN_SCATTERS_M[int(np.argmax(scores))]


@pytest.mark.parametrize("scatter_m", [0.0002, 0.0008, 0.0015, 0.003])
@pytest.mark.parametrize("repeat_m", [NOISE.repeat_m, 0.0015, 0.002, 0.003])
def test_it_is_the_most_probable_of_the_tried_ones(scatter_m: float, repeat_m: float) -> None:
    captures, noise = repeats(scatter_m), replace(NOISE, repeat_m=repeat_m)
    assert pin_scatter(captures, noise) == directly(captures, noise)


def test_it_grows_with_what_the_magnets_were_off_by() -> None:
    """At about 0.4 of it, since differences count in part."""
    found = {true: pin_scatter(repeats(true, count=12), NOISE) for true in (0.0, 0.001, 0.002, 0.004, 0.02)}
    assert list(found.values()) == sorted(found.values())
    assert found[0.0] == PIN_SCATTERS_M[0] and found[0.02] == PIN_SCATTERS_M[-1]
    for true in (0.001, 0.002, 0.004):
        assert 0.3 * true <= found[true] <= 0.5 * true


def test_what_all_repeats_share_is_no_scatter() -> None:
    captures = repeats(0.002)
    shared = 0.01 * np.random.default_rng(9).standard_normal(CELLS)
    moved = [replace(c.measured, shape=c.measured.shape + shared) for c in captures]
    before = pin_scatter(captures, NOISE)
    for capture, measured in zip(captures, moved, strict=True):
        capture.measured = measured
    assert pin_scatter(captures, NOISE) == before > PIN_SCATTERS_M[0]


def test_only_repeats_of_one_fabric_in_one_fold_state_are_held_against_each_other() -> None:
    first, second = repeats(0.004, count=2)
    assert pin_scatter([first, second], NOISE) > UNSEEN_PIN_M
    for name, other in (("fabric", "f2"), ("state", 1), ("scene", "hanging")):
        own = getattr(second, name)
        setattr(second, name, other)
        assert pin_scatter([first, second], NOISE) == UNSEEN_PIN_M
        setattr(second, name, own)
    assert pin_scatter([first], NOISE) == pin_scatter([], NOISE) == UNSEEN_PIN_M
    assert pin_scatter(repeats(0.004, scene="hanging"), NOISE) == UNSEEN_PIN_M
    calm, wild = repeats(0.0, fabric="f2"), repeats(0.02, fabric="f3", scene="hanging")
    assert pin_scatter([*calm, *wild], NOISE) == PIN_SCATTERS_M[0]


def test_cells_that_one_repeat_does_not_show_say_nothing() -> None:
    captures = repeats(0.002)
    for capture in captures:
        capture.measured.shape[:10] += 1.0 * np.random.default_rng(3).random(10) * (capture is captures[0])
    spoilt = pin_scatter(captures, NOISE)
    captures[0].measured.shape[:10] = np.nan
    captures[1].measured.plane[:] = np.nan
    whole = pin_scatter(repeats(0.002), NOISE)
    assert spoilt == PIN_SCATTERS_M[-1] > pin_scatter(captures, NOISE) == whole
    for capture in captures:
        capture.measured.shape[24:] = np.nan
    assert pin_scatter(captures, NOISE) > 0.6 * whole


@pytest.mark.parametrize("larger", [{"repeat_m": 0.01}, {"floor_m": 0.01}, {"slide_m": 0.05}])
def test_what_may_differ_otherwise_is_not_laid_to_the_magnets(larger: dict[str, float]) -> None:
    captures = repeats(0.002)
    for capture in captures:
        capture.reference.slope[:] = 0.5
        capture.measured.plane[:] = np.nan
    assert pin_scatter(captures, replace(NOISE, **larger)) < pin_scatter(captures, NOISE)  # type: ignore[arg-type]
    if "slide_m" in larger:
        alike = replace(NOISE, slide_m=0.05, repeat_share=0.0)  # folds slide in all repeats alike
        assert pin_scatter(captures, alike) >= pin_scatter(captures, NOISE)


def test_a_noisy_sensor_is_not_laid_to_the_magnets() -> None:
    captures = repeats(0.002)
    calm = pin_scatter(captures, NOISE)
    for capture in captures:
        capture.measured.pixels[0] = LOG_NOISE + 3.0
        capture.measured.plane[:] = np.nan
    assert pin_scatter(captures, NOISE) < calm
    for capture in captures:
        capture.measured.weight[:] = 1e6  # so many pixels have a mean without noise
    assert pin_scatter(captures, NOISE) >= calm
