"""What the pictures of a sweep's drapes show of its sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from renderer.sensor import IDEAL_SENSOR, SR300_LIKE, SensorModel
from renderer.sensor_holes import depth_edges
from renderer.store import RowStatus
from renderer.store_format import DEPTH_UNIT_M
from services.cli import dataset as command
from services.cli.main import run
from services.cli.simulate_files import take_picture
from services.dataset.configuration import SweepConfiguration
from services.dataset.extension import build_scene
from services.dataset.shard import apply_sensor, as_fabric, render_pictures, simulate_and_render
from simcore.drape import Drape, DrapeStatus
from simcore.solver import Solver
from tests.services.dataset_helpers import small_sweep

IDEAL, FABRICS = small_sweep()
SR300, _ = small_sweep(sensor="sr300")
FABRIC = FABRICS.parameters([0])[0]


def bulging() -> Drape:
    """A sheet that stands 0.12 m before the panel at its sides and bulges by 30 mm more."""
    u, v = IDEAL.mesh.material_coordinates.T
    vertices = np.stack([u - 0.25, -v, 0.12 + 0.03 * np.sin(np.pi * u / 0.5)], axis=1)
    return Drape(IDEAL.mesh, vertices, DrapeStatus.STILL, 1e-4, -0.1, True, 7, 0.1, "")


class Bulging(Solver):
    """Finds that sheet whatever it is asked for."""

    def __init__(self) -> None:
        """Without a mesh of its own."""

    def solve(self, *arguments: object, **options: object) -> Drape:
        """The sheet."""
        return bulging()


def stored(configuration: SweepConfiguration, seed: int = 1) -> np.ndarray:
    """A simulation's pictures as its rows hold them [m], [inclinations, H, W]."""
    outcome = simulate_and_render(FABRIC, "hanging", seed, configuration, Bulging())
    assert outcome.status is RowStatus.OK
    return outcome.depth * DEPTH_UNIT_M


@pytest.fixture(scope="module")
def ideal() -> np.ndarray:
    return stored(IDEAL)


@pytest.fixture(scope="module")
def sr300() -> np.ndarray:
    return stored(SR300)


def test_an_ideal_sensor_stores_what_was_rendered(ideal: np.ndarray) -> None:
    rendered = render_pictures(bulging(), build_scene(IDEAL, "hanging", as_fabric(FABRIC), 1), IDEAL)
    assert np.abs(ideal - rendered).max() <= 0.5 * DEPTH_UNIT_M + 1e-7


def test_an_sr300_stores_its_noise_and_its_holes(ideal: np.ndarray, sr300: np.ndarray) -> None:
    """Its noise, growing as z²; here and there a hole, at edges many, and the projector's shadow."""
    for plain, seen in zip(ideal, sr300, strict=True):
        edges = depth_edges(plain.astype(np.float32), SR300_LIKE.edge_jump_m)
        smooth = ~binary_dilation(edges, iterations=5)
        calm = smooth & (seen > 0.0)
        noise = (seen - plain)[calm] * (SR300_LIKE.at_m / plain[calm]) ** 2
        assert noise.std() == pytest.approx(SR300_LIKE.range_noise_m, rel=0.05)
        assert abs(noise.mean()) < 0.05 * SR300_LIKE.range_noise_m
        lost = seen == 0.0
        assert lost[smooth].mean() == pytest.approx(SR300_LIKE.dropout, rel=0.3)
        sheet = plain < plain[:, :1] - 0.05
        beside = {side: ~sheet & (np.roll(sheet, -side, 1) | np.roll(sheet, -2 * side, 1)) for side in (1, -1)}
        assert lost[beside[1]].mean() > 0.9, "the projector stands at the camera's right"
        assert lost[beside[-1]].mean() < 0.2


def test_each_picture_and_each_simulation_has_noise_of_its_own(ideal: np.ndarray, sr300: np.ndarray) -> None:
    assert np.array_equal(stored(SR300), sr300)
    off, other = sr300 - ideal, stored(SR300, seed=2) - ideal
    flat = (ideal > 0.0) & (sr300 > 0.0) & (np.abs(off) < 0.005) & (np.abs(other) < 0.005)
    both = flat.all(axis=0)
    assert both.mean() > 0.3
    for first, second in ((off[0], off[1]), (off[0], other[0]), (off[1], other[1])):
        assert abs(np.corrcoef(first[both], second[both])[0, 1]) < 0.05


def test_pictures_that_are_alike_are_read_apart() -> None:
    """The same picture twice: two draws of the noise, the first of which does not hang on how many follow."""
    scene = replace(
        build_scene(IDEAL, "hanging", as_fabric(FABRIC), 1), sensor=SensorModel(range_noise_m=0.001, dropout=0.1)
    )
    depth = np.full((3, scene.camera.height, scene.camera.width), 0.9, np.float32)
    seen = apply_sensor(depth, 5, scene)
    assert not any(np.array_equal(seen[a], seen[b]) for a, b in ((0, 1), (0, 2), (1, 2)))
    assert np.array_equal(apply_sensor(depth[:1], 5, scene)[0], seen[0])
    assert apply_sensor(depth, 5, replace(scene, sensor=IDEAL_SENSOR)) is depth


def test_simulate_s_picture_goes_through_the_scene_s_sensor() -> None:
    scene = build_scene(IDEAL, "hanging", as_fabric(FABRIC), 1)
    noisy = replace(scene, sensor=SensorModel(range_noise_m=0.002))
    plain, first, again, other = (
        take_picture(bulging(), one, seed) for one, seed in ((scene, 1), (noisy, 1), (noisy, 1), (noisy, 2))
    )
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    noise = ((first - plain) * (0.9 / np.maximum(plain, 0.1)) ** 2)[plain > 0.0]
    assert noise.std() == pytest.approx(0.002, rel=0.02)


@pytest.mark.parametrize(("options", "sensor"), [((), "ideal"), (("--sensor", "sr300"), "sr300")])
def test_the_command_hands_the_sensor_on(
    options: tuple[str, ...], sensor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned: list[SweepConfiguration] = []
    monkeypatch.setattr(command, "sweep", lambda out, configuration, *rest, **more: planned.append(configuration))
    assert run(["dataset", "--materials", "2", "--resolution", "0.05", "--out", "s.zarr", *options]) == 0
    (configuration,) = planned
    assert configuration.sensor == sensor
    built = build_scene(configuration, "stretch", as_fabric(FABRIC), 1)
    assert built.sensor == (SR300_LIKE if sensor == "sr300" else IDEAL_SENSOR)
