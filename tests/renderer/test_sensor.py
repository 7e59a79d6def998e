"""Each mechanism of the depth sensor by its statistics."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from renderer.camera import CANONICAL_CAMERA, frontal_pose, ray_directions
from renderer.depth import render_buffers, render_depth
from renderer.sensor import IDEAL_SENSOR, SR300_LIKE, SensorModel, named_sensor
from renderer.sensor_holes import (
    add_flying_pixels,
    cast_shadow,
    depth_edges,
    drop_edges,
    drop_grazing,
    drop_readings,
)
from renderer.sensor_noise import (
    add_range_noise,
    bias_depth,
    quantise_disparity,
    quantise_uniform,
    scale_depth,
    smooth_depth,
)
from simcore.errors import InputError
from tests.renderer.surfaces import drape_like, height_field

POSE = frontal_pose()
CAMERA = CANONICAL_CAMERA


def flat(depth: float, size: int = 400) -> np.ndarray:
    return np.full((size, size), depth, dtype=np.float32)


@pytest.fixture(scope="module")
def box() -> np.ndarray:
    """A board 0.1 m before the panel, with a hole in the data."""
    mesh = height_field(lambda x, y: np.full_like(x, 0.1), x=(-0.15, 0.15), y=(-0.4, -0.1), cells=4)
    depth = render_depth(*mesh, CAMERA, POSE)
    depth[120:130, 40:50] = 0.0
    return depth


def rng() -> np.random.Generator:
    return np.random.default_rng(42)


def test_off_is_the_identity(box: np.ndarray) -> None:
    assert IDEAL_SENSOR.off
    assert not SR300_LIKE.off
    assert np.array_equal(IDEAL_SENSOR.apply(box, rng()), box)
    assert np.array_equal(SensorModel(at_m=0.5, quantisation="disparity").apply(box, rng()), box)


def test_range_noise_has_the_stated_deviation_and_grows_as_z_squared() -> None:
    for z in (0.45, 0.9, 1.8):
        noise = add_range_noise(flat(z), 0.001, 0.9, rng()).astype(float) - np.float32(z)
        expected = 0.001 * (z / 0.9) ** 2
        assert noise.std() == pytest.approx(expected, rel=0.01)
        assert abs(noise.mean()) < 5 * expected / 400
        assert abs(np.corrcoef(noise[:, 1:].ravel(), noise[:, :-1].ravel())[0, 1]) < 0.01


def test_quantisation_steps() -> None:
    ramp = np.linspace(0.5, 1.5, 40000, dtype=np.float32).reshape(200, 200)
    uniform = quantise_uniform(ramp, 0.002)
    np.testing.assert_allclose(uniform, np.rint(uniform / 0.002) * 0.002, atol=1e-6)
    assert np.abs(uniform - ramp).max() <= 0.001 + 1e-6
    disparity = quantise_disparity(ramp, 0.002, 0.9)
    levels = np.unique(disparity)
    steps = np.diff(levels.astype(float))
    middle = 0.5 * (levels[1:] + levels[:-1])
    np.testing.assert_allclose(steps, 0.002 * (middle / 0.9) ** 2, rtol=0.02)


def test_scale_and_bias(box: np.ndarray) -> None:
    np.testing.assert_allclose(scale_depth(box, 0.01), box * 1.01, rtol=1e-6)
    moved = bias_depth(box, -0.005)
    np.testing.assert_allclose(moved[box > 0], box[box > 0] - 0.005, atol=1e-6)
    assert np.all(moved[box == 0] == 0)
    assert np.all(bias_depth(box, -2.0) == 0)


def test_smoothing_blurs_noise_and_leaves_planes_and_holes(box: np.ndarray) -> None:
    noisy = add_range_noise(flat(0.9), 0.001, 0.9, rng())
    sigma = 1.5
    assert smooth_depth(noisy, sigma).std() == pytest.approx(0.001 / (2 * math.sqrt(math.pi) * sigma), rel=0.03)
    smoothed = smooth_depth(box, sigma)
    assert np.array_equal(smoothed == 0, box == 0)
    np.testing.assert_allclose(smoothed[:40], box[:40], atol=1e-6)
    np.testing.assert_allclose(smoothed[115:135, 35:55][box[115:135, 35:55] > 0], 0.9, atol=1e-6)


def test_flying_pixels_lie_between_the_sides_of_edges_only(box: np.ndarray) -> None:
    edges = depth_edges(box)
    flying = add_flying_pixels(box, 0.5, rng())
    changed = flying != box
    assert not np.any(changed & ~edges)
    assert changed.sum() / edges.sum() == pytest.approx(0.5, abs=0.06)
    assert np.all((flying[changed] >= 0.8 - 1e-6) & (flying[changed] <= 0.9 + 1e-6))
    assert flying[changed].std() == pytest.approx(0.1 / math.sqrt(12), rel=0.15)
    assert not depth_edges(flat(0.9)).any()


def test_edges_follow_the_outline(box: np.ndarray) -> None:
    edges = depth_edges(box)
    perimeter = 4 * 0.3 / 0.8 * 320
    assert edges.sum() == pytest.approx(2 * perimeter, rel=0.02)
    assert not edges[:, :60].any(), "holes are no edge"


def test_dropout_shares_and_patches() -> None:
    single = drop_readings(flat(0.9), 0.05, rng()) == 0
    patches = drop_readings(flat(0.9), 0.05, rng(), patch_px=3.0) == 0
    for lost in (single, patches):
        assert lost.mean() == pytest.approx(0.05, abs=0.003)

    def together(lost: np.ndarray) -> float:
        return float((lost[:, 1:] & lost[:, :-1]).sum() / lost.sum())

    assert together(single) < 0.08
    assert together(patches) > 0.7


def test_edge_dropout_only_at_edges(box: np.ndarray) -> None:
    lost = (drop_edges(box, 0.4, rng()) == 0) & (box > 0)
    edges = depth_edges(box)
    assert not np.any(lost & ~edges)
    assert lost.sum() / edges.sum() == pytest.approx(0.4, abs=0.06)


def test_shadow_has_the_width_of_triangulation(box: np.ndarray) -> None:
    """Projector to the right: shadow to the left of the board, fx b (1/z_near - 1/z_far) wide."""
    baseline = 0.05
    width = CAMERA.fx * baseline * (1 / 0.8 - 1 / 0.9)
    board = np.flatnonzero(np.abs(box[100] - 0.8) < 1e-4)
    for sign, side in ((1, board[0] - 1), (-1, board[-1] + 1)):
        lost = cast_shadow(box, CAMERA, sign * baseline)[100] == 0
        assert lost.sum() == pytest.approx(width, abs=1.0)
        assert lost[side]
    assert np.array_equal(cast_shadow(flat(0.9), CAMERA, baseline), flat(0.9))


def test_grazing_surface_is_lost() -> None:
    radius = 0.2
    mesh = height_field(lambda x, y: np.sqrt(np.maximum(radius**2 - x**2, 0.0)), x=(-0.2, 0.2), cells=400)
    buffers = render_buffers(*mesh, CAMERA, POSE)
    rays = ray_directions(CAMERA)
    cosine = np.abs(np.sum(buffers.normals * rays, axis=-1)) / np.linalg.norm(rays, axis=-1)
    angle = np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))
    lost = drop_grazing(buffers.depth, CAMERA, 60.0) == 0
    inner = buffers.cloth & np.roll(buffers.cloth, 2, 1) & np.roll(buffers.cloth, -2, 1)
    assert np.all(lost[inner & (angle > 63.0)])
    assert not np.any(lost[angle < 57.0])


def test_same_seed_same_bits_and_streams_apart() -> None:
    depth = render_depth(*drape_like(), CAMERA, POSE)
    first = SR300_LIKE.apply(depth, rng(), camera=CAMERA)
    assert np.array_equal(first, SR300_LIKE.apply(depth, rng(), camera=CAMERA))
    assert not np.array_equal(first, SR300_LIKE.apply(depth, np.random.default_rng(1), camera=CAMERA))
    noise = SensorModel(range_noise_m=0.001)
    with_holes = SensorModel(range_noise_m=0.001, dropout=0.1, flying_pixels=0.2)
    a, b = noise.apply(depth, rng()), with_holes.apply(depth, rng())
    untouched = (b > 0) & ~depth_edges(depth)
    assert np.array_equal(a[untouched], b[untouched]), "one mechanism leaves the others' noise as it was"


def test_noise_in_the_picture_is_as_stated_with_smoothing_on() -> None:
    sensor = SensorModel(range_noise_m=0.001, smoothing_px=2.0, quantisation_m=0.0002)
    noise = sensor.apply(flat(0.9), rng()).std()
    assert noise == pytest.approx(math.hypot(0.001, 0.0002 / math.sqrt(12)), rel=0.02)


@pytest.mark.parametrize(
    ("setting", "code", "told"),
    [
        ({"range_noise_m": -0.001}, "sensor_range_noise", "range noise -0.001 m"),
        ({"range_noise_m": math.nan}, "sensor_range_noise", "range noise nan m"),
        ({"range_noise_m": 0.001, "at_m": 0.0}, "sensor_range_noise", "reference depth 0.0 m must be above 0"),
        ({"quantisation_m": -1.0}, "sensor_quantisation", "-1.0 m must be from 0 to 1"),
        ({"quantisation": "log"}, "sensor_quantisation", "'log': choose uniform or disparity"),
        ({"flying_pixels": 1.5}, "sensor_flying_pixels", "share from 0 to 1"),
        ({"dropout": -0.1}, "sensor_dropout", "dropout -0.1 must be a share"),
        ({"dropout": 0.1, "dropout_patch_px": -1.0}, "sensor_dropout", "-1.0 px must be from 0 to 100"),
        ({"edge_dropout": math.nan}, "sensor_edge_dropout", "share from 0 to 1"),
        ({"smoothing_px": -1.0}, "sensor_smoothing", "-1.0 px must be from 0 to 100"),
        ({"depth_scale": -1.0}, "sensor_depth_scale", "-1.0 must be from -0.9 to 9"),
        ({"depth_bias_m": math.inf}, "sensor_depth_bias", "inf m must be from -65 to 65"),
        ({"depth_bias_m": -70.0}, "sensor_depth_bias", "-70.0 m must be from -65 to 65"),
        ({"grazing_limit_deg": 0.0}, "sensor_grazing", "above 0 and at most 90"),
        ({"shadow_baseline_m": 3.0}, "sensor_shadow", "3.0 m must be from -1 to 1"),
        ({"edge_jump_m": 0.0}, "sensor_edge_jump", "edge jump 0.0 m must be positive"),
    ],
)
def test_bad_magnitudes_are_refused(setting: dict[str, Any], code: str, told: str) -> None:
    with pytest.raises(InputError, match=told) as caught:
        SensorModel(**setting)
    assert caught.value.code == code


def test_bad_pictures_are_refused(box: np.ndarray) -> None:
    for bad in (box[0], -box, np.full((4, 4), np.nan)):
        with pytest.raises(InputError, match="0 where there is no data") as caught:
            IDEAL_SENSOR.apply(bad, rng())
        assert caught.value.code == "depth_invalid"
    with pytest.raises(InputError, match="pass camera=") as caught:
        SR300_LIKE.apply(box, rng())
    assert caught.value.code == "camera"


def test_sensors_by_name() -> None:
    assert named_sensor("sr300") is SR300_LIKE
    with pytest.raises(InputError, match="ideal or sr300"):
        named_sensor("kinect")


def test_every_setting_is_documented() -> None:
    for setting in fields(SensorModel):
        assert f"{setting.name}:" in (SensorModel.__doc__ or "")


def test_noise_matches_the_open_case(shared_dir: Any) -> None:
    """The panel's noise in a case of known added range noise: sqrt(known² + added² + quantisation)."""
    import json

    from renderer.depth_png import read_depth_png

    label = json.loads((shared_dir / "cases" / "open-5.label.json").read_text())["effects"][0]
    assert label["name"] == "range_noise"
    real = read_depth_png(shared_dir / "cases" / "open-5" / "f1-hanging-0.png")[5:40, 5:630]
    sensor = SensorModel(range_noise_m=math.hypot(0.001, label["magnitude"]), at_m=0.9, quantisation_m=0.0002)
    ours = sensor.apply(flat(0.9), rng())
    assert ours.std() == pytest.approx(real.std(), rel=0.03)
