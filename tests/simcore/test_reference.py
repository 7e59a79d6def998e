"""Kernels against the NumPy reference, and the reference against complex steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simcore.grid import Grid
from simcore.mechanics import Crease, EdgeCurl, FrozenCurvature, Mechanics, UniformCurvature

from .reference import Cloth, Friction, complex_step_gradient
from .rigs import ANISOTROPIC, Array, Level, Rig, crumpled

GRID = Grid(7, 9, 0.021, 0.017)
HELD = np.zeros((7, 9), dtype=bool)
HELD[0, [0, 1, -1]] = True
HELD[1, 0] = True

CURLS = (UniformCurvature(8.0, -5.0), EdgeCurl(40.0), Crease(1.2, "weft", 0.4, 0.03), FrozenCurvature(6.0, 3))
HOOKS = {
    "baseline": Mechanics(),
    "gravity": Mechanics(gravity=(0.4, -9.0, 2.1)),
    "air": Mechanics(air_pressure_pa=0.7),
    "off_grain": Mechanics(off_grain_rad=0.35),
    "stiffening": Mechanics(stiffening_strain=0.03),
    "rest_curvature": Mechanics(rest_curvature=CURLS),
    "hem": Mechanics(hem_kg_m=0.05),
    "trim": Mechanics(hem_kg_m=0.01, trim_kg_m=(0.02, 0.03, 0.04, 0.05)),
    "adhesion": Mechanics(adhesion_pa=3.0, adhesion_range_m=4e-3),
    "friction": Mechanics(friction=0.4),
    "everything": Mechanics(
        (0.1, -9.7, -0.5), -0.4, -0.2, 0.05, (UniformCurvature(3.0, 9.0), EdgeCurl(-25.0)), 0.02, 1.5, 3e-3, 0.3
    ),
}


def rig_of(hook: str, level: Level | None = None) -> Rig:
    return rig_with(HOOKS[hook], level)


def rig_with(mechanics: Mechanics, level: Level | None = None) -> Rig:
    """The sample with these mechanics before its panel; friction, where there is some, with bounds drawn at random."""
    friction = None
    if mechanics.friction:
        rng = np.random.default_rng(5)
        bound = mechanics.friction * 1e-3 * rng.uniform(0.0, 1.0, HELD.shape) * ~HELD
        friction = Friction(bound, GRID.rest[..., :2] + 4e-4 * rng.standard_normal((*HELD.shape, 2)))
    return Rig.of(level or Level(GRID), ANISOTROPIC, HELD, mechanics, panel=True, friction=friction)


@pytest.fixture(scope="module")
def level() -> Level:
    return Level(GRID)


def relative(a: Array, b: Array) -> float:
    return float(np.abs(a - b).max() / np.abs(b).max())


@pytest.mark.parametrize("hook", HOOKS)
def test_energy_and_gradient_are_those_of_the_reference(hook: str, level: Level) -> None:
    rig = rig_of(hook, level)
    for seed in range(3):
        x = crumpled(GRID, seed)
        assert level.energy(x) == pytest.approx(rig.cloth.energy(x), rel=1e-9)
        assert relative(level.gradient(x), rig.cloth.gradient(x)) < 1e-9
        assert level.residual(level.gradient(x)) == pytest.approx(rig.cloth.residual(x), rel=1e-9)


@pytest.mark.parametrize("hook", HOOKS)
def test_the_reference_is_the_derivative_of_its_own_energy(hook: str) -> None:
    cloth = rig_of(hook).cloth
    x = crumpled(GRID, 11)
    assert relative(cloth.gradient(x), complex_step_gradient(cloth, x)) < 1e-11


def test_each_hook_does_something_and_nothing_at_magnitude_zero(level: Level) -> None:
    x = crumpled(GRID, 4)
    rig_of("baseline", level)
    energy, gradient = level.energy(x), level.gradient(x)
    for hook in HOOKS:
        if hook != "baseline":
            assert relative(rig_of(hook, level).level.gradient(x), gradient) > 1e-6, hook
    zeros = Mechanics(
        off_grain_rad=0.0, hem_kg_m=0.0, adhesion_pa=0.0, friction=0.0, air_pressure_pa=0.0,
        rest_curvature=(UniformCurvature(0.0, 0.0), EdgeCurl(0.0), Crease(0.0), FrozenCurvature(0.0)),
    )  # fmt: skip
    rest = Rig.of(level, ANISOTROPIC, HELD, zeros, panel=True)
    assert rest.level.energy(x) == energy
    assert np.array_equal(rest.level.gradient(x), gradient)
    never = replace(zeros, stiffening_strain=1e9, rest_curvature=())
    assert relative(Rig.of(level, ANISOTROPIC, HELD, never, panel=True).level.gradient(x), gradient) < 1e-12


def test_rigid_motion_costs_nothing(level: Level) -> None:
    rig = Rig.of(level, ANISOTROPIC, np.zeros_like(HELD), Mechanics(rest_curvature=CURLS[:1]))
    weightless = replace(rig.cloth, fabric=replace(ANISOTROPIC, density=5e-3))
    rng = np.random.default_rng(2)
    x = crumpled(GRID, 6)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    moved = x @ turn.T + np.array([0.3, -2.0, 1.1])
    load = level.loads.force
    before, after = level.energy(x) + np.vdot(load, x), level.energy(moved) + np.vdot(load, moved)
    assert after == pytest.approx(before, rel=1e-10)
    # forces turn with the cloth
    assert relative(level.gradient(moved) + load, (level.gradient(x) + load) @ turn.T) < 1e-9
    # and a flat sheet, wherever it lies, is free of them
    flat = GRID.rest @ turn.T + 1.0
    plain = Rig.of(level, weightless.fabric, np.zeros_like(HELD))
    forces = plain.level.gradient(flat) + plain.level.loads.force
    assert np.abs(forces).max() < 1e-9 * weightless.fabric.stretch_warp * GRID.hu


def test_nothing_may_be_behind_the_panel(level: Level) -> None:
    rig = rig_of("baseline", level)
    x = crumpled(GRID, 1)
    assert np.isfinite(level.energy(x))
    x[3, 3, 2] = 0.0
    assert level.energy(x) == np.inf
    assert rig.cloth.energy(x) == np.inf
    x[3, 3, 2] = 1e-3
    x[0, 0, 2] = -1e-3  # held: the magnet decides
    assert np.isfinite(level.energy(x))


def test_mirrored_cloth_has_the_mirrored_energy(level: Level) -> None:
    """Left and right, front and back, and warp for weft."""
    fabric = ANISOTROPIC
    x = crumpled(GRID, 8)
    free = np.zeros_like(HELD)
    energy = Rig.of(level, fabric, free).level.energy(x)
    gradient = level.gradient(x)
    assert level.energy(x[:, ::-1] * [-1.0, 1.0, 1.0]) == pytest.approx(energy, rel=1e-12)
    assert relative(level.gradient(x[:, ::-1] * [-1.0, 1.0, 1.0])[:, ::-1] * [-1.0, 1.0, 1.0], gradient) < 1e-12
    assert level.energy(x * [1.0, 1.0, -1.0]) == pytest.approx(energy, rel=1e-12)
    swapped = replace(
        fabric, stretch_warp=fabric.stretch_weft, stretch_weft=fabric.stretch_warp,
        bending_warp=fabric.bending_weft, bending_weft=fabric.bending_warp,
    )  # fmt: skip
    other = Rig.of(Level(Grid(9, 7, GRID.hv, GRID.hu)), swapped, np.zeros((9, 7), dtype=bool))
    assert other.level.energy(np.swapaxes(x, 0, 1).copy()) == pytest.approx(energy, rel=1e-12)


def test_residual_counts_free_vertices_in_weights_of_an_inner_one() -> None:
    held = np.zeros((5, 5), dtype=bool)
    held[0] = True
    cloth = Cloth(ANISOTROPIC, 0.02, 0.02, held, panel=False)
    x = Grid(5, 5, 0.02, 0.02).rest  # unstretched: nothing balances the weight
    weights = cloth.areas()[~held] / 0.02**2
    assert cloth.residual(x) == pytest.approx(np.sqrt(np.mean(weights**2)), rel=1e-6)
