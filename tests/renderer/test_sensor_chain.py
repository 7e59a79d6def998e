"""The settings of a sensor where they stand in its chain: on what each mechanism works, and what comes after it."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from renderer.camera import Camera
from renderer.sensor import IDEAL_SENSOR, SensorModel
from renderer.sensor_holes import depth_edges

CAMERA = Camera(160, 120, 320.0, 320.0, 79.5, 59.5)
NEAR_M, FAR_M = 0.8, 0.9
LEFT, RIGHT = 50, 110
"""Columns of the board, the right one excluded."""


def flat(depth_m: float = FAR_M) -> np.ndarray:
    return np.full((CAMERA.height, CAMERA.width), depth_m, np.float32)


def board() -> np.ndarray:
    """A board 0.1 m before a panel that has a hole in its data, a step of 9 mm and a slope at its right that grazes."""
    depth = flat()
    depth[30:90, LEFT:RIGHT] = NEAR_M
    depth[5:10, 20:30] = 0.0
    depth[100:] += np.float32(0.009)
    depth[:, 150:] += np.float32(0.009) * np.arange(10, dtype=np.float32)
    return depth


def seen(depth: np.ndarray, seed: int = 42, **settings: Any) -> np.ndarray:
    return SensorModel(**settings).apply(depth, np.random.default_rng(seed), camera=CAMERA)


EVERYTHING = SensorModel(
    shadow_baseline_m=0.05,
    grazing_limit_deg=70.0,
    depth_scale=0.01,
    depth_bias_m=0.003,
    flying_pixels=0.5,
    smoothing_px=0.8,
    range_noise_m=0.001,
    at_m=0.7,
    filter_px=0.6,
    edge_dropout=0.2,
    dropout=0.05,
    dropout_patch_px=1.5,
    quantisation_m=0.0005,
    quantisation="disparity",
    edge_jump_m=0.008,
)


@pytest.mark.parametrize("name", [setting.name for setting in fields(SensorModel)])
def test_every_setting_reaches_the_picture(name: str) -> None:
    without = replace(EVERYTHING, **{name: getattr(IDEAL_SENSOR, name)})
    with_it, plain = (one.apply(board(), np.random.default_rng(3), camera=CAMERA) for one in (EVERYTHING, without))
    assert not np.array_equal(with_it, plain)


def test_edge_dropout_takes_its_share_of_the_ideal_picture_s_edges_alone() -> None:
    edges = depth_edges(board())
    lost = (seen(board(), edge_dropout=0.4) == 0.0) & (board() > 0.0)
    assert not (lost & ~edges).any()
    assert lost.sum() / edges.sum() == pytest.approx(0.4, abs=0.08)


def test_noise_makes_no_edges_to_lose() -> None:
    noisy = seen(flat(), range_noise_m=0.02)
    assert depth_edges(noisy).mean() > 0.5
    assert np.array_equal(seen(flat(), range_noise_m=0.02, edge_dropout=1.0), noisy)


def test_edges_that_smoothing_levels_are_lost_all_the_same() -> None:
    """15 mm between neighbours, some 5 mm once the optics have blurred them."""
    step = flat()
    step[:, 80:] += np.float32(0.015)
    assert not depth_edges(seen(step, smoothing_px=1.5)).any()
    lost = seen(step, smoothing_px=1.5, edge_dropout=1.0) == 0.0
    assert lost[:, 79:81].all() and lost.sum() == 2 * len(step)


@pytest.mark.parametrize("mechanism", ["flying_pixels", "edge_dropout"])
def test_how_large_a_step_is_an_edge_is_one_setting_for_both(mechanism: str) -> None:
    step = flat()
    step[:, 80:] += np.float32(0.009)
    touched = seen(step, edge_jump_m=0.008, **{mechanism: 1.0}) != step
    assert touched[:, 79:81].all() and touched.sum() == 2 * len(step)
    assert np.array_equal(seen(step, edge_jump_m=0.01, **{mechanism: 1.0}), step)


@pytest.mark.parametrize(("baseline_m", "beside"), [(0.05, LEFT - 1), (-0.05, RIGHT)])
def test_the_shadow_falls_away_from_the_projector(baseline_m: float, beside: int) -> None:
    """Projector at the camera's right: the board's shadow lies at its left, as wide as triangulation has it."""
    row = seen(board(), shadow_baseline_m=baseline_m)[60, :150]
    width = CAMERA.fx * abs(baseline_m) * (1.0 / NEAR_M - 1.0 / FAR_M)
    assert row[beside] == 0.0
    assert (row == 0.0).sum() == pytest.approx(width, abs=1.0)
    assert row[LEFT:RIGHT].all()


def test_edges_in_the_shadow_are_none() -> None:
    """What has no data has no other side: at the board's left nothing is left to mix with."""
    flying = seen(board(), shadow_baseline_m=0.05, flying_pixels=1.0)
    assert np.array_equal(flying[40:80, LEFT], board()[40:80, LEFT])
    assert not np.array_equal(flying[40:80, RIGHT], board()[40:80, RIGHT])


def test_patches_make_holes_that_hang_together() -> None:
    single, patched = (seen(flat(), dropout=0.05, dropout_patch_px=size) == 0.0 for size in (0.0, 3.0))
    for lost, least, most in ((single, 0.0, 0.15), (patched, 0.7, 1.0)):
        assert lost.mean() == pytest.approx(0.05, abs=0.01)
        beside = lost[:, 1:] & lost[:, :-1]
        assert least < beside.sum() / lost.sum() < most


def test_steps_are_alike_everywhere_or_grow_as_z_squared() -> None:
    ramp = np.linspace(0.5, 1.5, 120 * 160, dtype=np.float32).reshape(120, 160)
    steps = {}
    for kind in ("uniform", "disparity"):
        levels = np.unique(seen(ramp, quantisation_m=0.004, at_m=0.75, quantisation=kind)).astype(float)
        middle, step = 0.5 * (levels[1:] + levels[:-1]), np.diff(levels)
        steps[kind] = [step[np.argmin(np.abs(middle - z))] for z in (0.6, 0.75, 1.2)]
    assert steps["uniform"] == pytest.approx([0.004] * 3, rel=1e-3)
    assert steps["disparity"] == pytest.approx([0.004 * (z / 0.75) ** 2 for z in (0.6, 0.75, 1.2)], rel=0.02)


def test_depths_are_scaled_first_and_then_biased() -> None:
    np.testing.assert_allclose(seen(flat(), depth_scale=0.1, depth_bias_m=0.05), 0.99 + 0.05, atol=1e-6)


def test_noise_is_that_of_the_depth_that_is_read() -> None:
    """At twice the depth, four times the noise; stated at 0.6 m, 2.25 times as much at 0.9 m."""
    assert seen(flat(), range_noise_m=0.001, depth_scale=1.0).std() == pytest.approx(0.004, rel=0.03)
    assert seen(flat(), range_noise_m=0.001, at_m=0.6).std() == pytest.approx(0.00225, rel=0.03)


@pytest.mark.parametrize(
    ("smoothing_px", "filter_px", "share"),
    [(1.5, 0.0, 1.0), (0.0, 1.5, 1.0 / (2.0 * math.sqrt(math.pi) * 1.5))],
)
def test_the_optics_blur_no_noise_and_the_filter_does(smoothing_px: float, filter_px: float, share: float) -> None:
    noise = seen(flat(), range_noise_m=0.001, smoothing_px=smoothing_px, filter_px=filter_px) - flat()
    assert noise.std() == pytest.approx(0.001 * share, rel=0.05)


def test_the_optics_blur_what_flies() -> None:
    """Light is mixed before the lens spreads it: a pixel beside the edge gets some of it."""
    blurred, still = seen(board(), smoothing_px=1.0, flying_pixels=1.0), seen(board(), smoothing_px=1.0)
    assert np.abs(blurred - still)[40:80, LEFT - 3].max() > 1e-4


def test_holes_neither_spread_nor_fill() -> None:
    """What is dropped is dropped last: the filter has seen it."""
    whole = seen(flat(), range_noise_m=0.001, filter_px=1.5)
    holed = seen(flat(), range_noise_m=0.001, filter_px=1.5, dropout=0.1)
    left = holed > 0.0
    assert left.mean() == pytest.approx(0.9, abs=0.01)
    assert np.array_equal(holed[left], whole[left])


def test_readings_are_whole_counts_at_last() -> None:
    """Whatever else is on: the electronics give counts."""
    uniform = replace(EVERYTHING, quantisation="uniform", quantisation_m=0.002)
    picture = uniform.apply(board(), np.random.default_rng(3), camera=CAMERA).astype(float)
    np.testing.assert_allclose(picture, np.rint(picture / 0.002) * 0.002, atol=1e-7)
    picture = EVERYTHING.apply(board(), np.random.default_rng(3), camera=CAMERA).astype(float)
    counts = (1.0 / picture[picture > 0.0]) / (EVERYTHING.quantisation_m / EVERYTHING.at_m**2)
    np.testing.assert_allclose(counts, np.rint(counts), atol=2e-3)
    assert (picture == 0.0).any()
