"""What differs between repeats of one capture: magnets, forces and the shape that a sample is put up from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simcore.grid import Grid
from simcore.mechanics import NO_JITTER, Jitter
from simcore.mesh import GridMesh
from simcore.placement import LIFT_M, Perturbation, Pins, put_up
from simcore.scenes import GRAVITY_M_S2, Scene, Setup
from simcore.solver import Solver

from .judge import positions
from .rigs import FABRICS

GRID = Grid(21, 21, 0.025, 0.025)
SETUP = Setup.nominal(Scene.STRETCH)
COARSE = GridMesh(0.05)


def drawn(jitter: Jitter, seed: int, setup: Setup = SETUP) -> Perturbation:
    return Perturbation.draw(setup, jitter, np.random.SeedSequence(seed))


@dataclass
class Recorder:
    """Cloth that nothing moves, and what pushed it, step by step, in its weight [rows, columns, 3]."""

    grid: Grid = GRID
    loads: Any = field(default_factory=lambda: SimpleNamespace(mass=1e-4 * (1.0 + np.arange(21.0) * np.ones((21, 21)))))
    pushes: list[np.ndarray] = field(default_factory=list)
    fixed: np.ndarray = field(default_factory=lambda: np.zeros((21, 21), np.int32))
    own_contact: None = None
    contact: Any = field(default_factory=lambda: SimpleNamespace(largest_step=lambda *_: 1.0))

    def push(self, force: np.ndarray | float) -> None:
        """Remember it."""
        weight = (self.loads.mass * GRAVITY_M_S2)[..., None]
        self.pushes.append(np.broadcast_to(force, self.grid.shape) / weight)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """None."""
        return np.zeros_like(x)

    def factor(self, *_: object, **__: object) -> int:
        """Done."""
        return 0

    def solve(self, right: np.ndarray) -> np.ndarray:
        """No way to go."""
        return np.zeros_like(right)


def start_of(jitter: Jitter, seed: int) -> np.ndarray:
    """The shape that a sample is put up from: that before any step [rows, columns, 3]."""
    one = drawn(jitter, seed)
    level: Any = Recorder()
    x, steps = put_up(level, Pins.of(GRID, SETUP, one.pin_moves), one, deadline=-math.inf)
    assert steps == 0
    return x


def pushes_of(jitter: Jitter, seed: int) -> np.ndarray:
    """All forces while it is put up, in weights, [steps + 1, rows, columns, 3]."""
    one, level = drawn(jitter, seed), Recorder()
    held: Any = level
    put_up(held, Pins.of(GRID, SETUP, one.pin_moves), one)
    return np.stack(level.pushes)


def test_magnets_are_off_in_the_panel_s_plane_by_the_stated_deviation() -> None:
    moves = np.stack([drawn(Jitter(pin_m=0.002), seed).pin_moves for seed in range(1500)])
    assert moves.shape == (1500, len(SETUP.pins_m), 3)
    assert not moves[..., 2].any()
    along = moves[..., :2].reshape(1500, -1)
    np.testing.assert_allclose(along.std(axis=0), 0.002, rtol=0.06)
    np.testing.assert_allclose(along.mean(axis=0), 0.0, atol=5 * 0.002 / math.sqrt(1500))
    apart = np.corrcoef(along.T) - np.eye(along.shape[1])
    assert np.abs(apart).max() < 0.12, "each magnet along each axis for itself"


def test_no_magnet_is_further_off_than_two_and_a_half_deviations() -> None:
    moves = np.abs([drawn(Jitter(pin_m=0.002), seed).pin_moves for seed in range(200)])
    assert moves.max() == pytest.approx(2.5 * 0.002)
    assert 0.002 < np.quantile(moves[..., :2], 0.95) < 2.2 * 0.002


@pytest.mark.parametrize("placement_m", [0.0, 0.02, 0.05])
def test_a_sample_is_put_up_from_a_smooth_shape_before_the_panel(placement_m: float) -> None:
    shapes = [start_of(replace(NO_JITTER, placement_m=placement_m), seed) for seed in (0, 1)]
    for x in shapes:
        assert np.array_equal(x[..., :2], GRID.rest[..., :2])
        assert x[..., 2].min() == pytest.approx(LIFT_M)
        assert x[..., 2].max() == pytest.approx(LIFT_M + placement_m)
        assert np.abs(np.diff(x[..., 2], axis=0)).max() <= 0.3 * placement_m
        assert np.abs(np.diff(x[..., 2], axis=1)).max() <= 0.3 * placement_m
    assert np.array_equal(shapes[0], shapes[1]) == (placement_m == 0.0)


def test_neither_magnets_nor_forces_shape_the_start() -> None:
    assert np.array_equal(start_of(Jitter(5.0, 0.01, 0.0), 0), start_of(Jitter(0.0, 0.0, 0.0), 1))


@pytest.mark.parametrize("weights", [0.5, 2.0])
def test_forces_are_in_weights_of_the_cloth_and_die_out(weights: float) -> None:
    pushes = pushes_of(replace(NO_JITTER, force_weights=weights), 3)
    np.testing.assert_allclose(np.sqrt(np.mean(pushes[0] ** 2, axis=(0, 1))), weights, rtol=1e-6)
    assert np.abs(np.diff(pushes[0], axis=1)).max() < 1.2 * weights, "smooth"
    strengths = np.sqrt(np.mean(pushes**2, axis=(1, 2, 3))) / weights
    assert (np.diff(strengths) <= 0.0).all()
    assert strengths[len(strengths) // 4] == pytest.approx(1.0 - 15.0 / 36.0, abs=0.03)
    assert not strengths[2 * len(strengths) // 3 :].any()
    fading = strengths > 0.0
    along = pushes[fading].reshape(fading.sum(), -1) / (strengths[fading] * weights)[:, None]
    np.testing.assert_allclose(along, along[:1].repeat(len(along), axis=0), atol=1e-9)


def test_without_forces_nothing_pushes_and_other_repeats_are_pushed_otherwise() -> None:
    assert not pushes_of(replace(Jitter(), force_weights=0.0), 3).any()
    one, other = (pushes_of(replace(NO_JITTER, force_weights=1.0), seed)[0] for seed in (3, 4))
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.6
    components = np.corrcoef(one.reshape(-1, 3).T) - np.eye(3)
    assert np.abs(components).max() < 0.9


def test_a_seed_means_the_same_on_every_mesh() -> None:
    one = drawn(Jitter(), 7)
    for component in range(4):
        coarse, fine = (one.field(Grid(n, n, 0.5 / (n - 1), 0.5 / (n - 1)), component) for n in (11, 41))
        assert np.corrcoef(coarse.ravel(), fine[::4, ::4].ravel())[0, 1] > 0.999999


@pytest.fixture(scope="module")
def coarse() -> Solver:
    """50 mm cells: a tenth of a second a drape."""
    return Solver(COARSE)


def apart_mm(solver: Solver, jitter: Jitter) -> float:
    """How far two repeats are from each other, root mean square; hanging, cloth has folds to choose from."""
    hanging = Setup.nominal(Scene.HANGING)
    one, other = (solver.solve(FABRICS["medium"], hanging, seed=seed, jitter=jitter) for seed in (1, 2))
    assert one.ok and other.ok
    return 1e3 * float(np.sqrt(np.mean((one.vertices - other.vertices) ** 2)))


@pytest.mark.parametrize("scale", [scale.name for scale in fields(Jitter)])
def test_each_scale_alone_makes_repeats_differ(scale: str, coarse: Solver) -> None:
    assert apart_mm(coarse, replace(NO_JITTER, **{scale: getattr(Jitter(), scale)})) > 1.0


def test_without_any_repeats_are_alike_bit_by_bit(coarse: Solver) -> None:
    assert apart_mm(coarse, NO_JITTER) == 0.0


def test_a_magnet_that_is_off_holds_its_corner_there(coarse: Solver) -> None:
    jitter = replace(NO_JITTER, pin_m=0.002)
    x = positions(coarse.solve(FABRICS["medium"], SETUP, seed=5, jitter=jitter))
    moves = dict(zip(SETUP.pins_m, drawn(jitter, 5).pin_moves, strict=True))
    for name, corner in {"top_left": x[0, 0], "top_right": x[0, -1], "bottom_right": x[-1, -1]}.items():
        assert np.linalg.norm(moves[name]) > 1e-4
        np.testing.assert_allclose(corner, SETUP.pins_m[name] + moves[name], atol=1e-9)
