"""The assembled Hessian: against differences of the gradient, its blend, and the inertia that certifies a minimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simcore.grid import Grid
from simcore.mechanics import Mechanics
from simcore.pardiso import Factorisation

from .reference import complex_step_gradient
from .rigs import Array, Level, crumpled
from .test_reference import GRID, HELD, HOOKS, relative, rig_of, rig_with


@pytest.fixture(scope="module")
def level() -> Level:
    return Level(GRID)


NO_STIFFNESS = ("gravity", "air", "hem", "trim")
"""Hooks that pull alike wherever the cloth is."""
PARTS = ("off_grain_rad", "stiffening_strain", "rest_curvature", "adhesion_pa", "friction")
"""Fields of mechanics that add to the Hessian."""


def differences(level: Level, x: Array, held: Array) -> Array:
    """Fourth-order central differences of the kernels' gradient, dense over the free vertices [N/m].

    Of the baseline they are within 4e-8 N/m of the exact Hessian; shorter steps lose more to rounding, longer ones more
    to the barrier of the panel.
    """
    free = np.flatnonzero(np.repeat(~held.ravel(), 3))
    step = 1e-6
    columns = []
    for n in free:
        d = np.zeros(x.size)
        d[n] = step
        d = d.reshape(x.shape)
        near = level.gradient(x + d) - level.gradient(x - d)
        far = level.gradient(x + 2 * d) - level.gradient(x - 2 * d)
        columns.append(((8 * near - far) / (12 * step)).ravel()[free])
    return np.array(columns)


def roomy() -> Array:
    """A crumpled state with some room over the panel, which differences need."""
    x = crumpled(GRID, 21)
    x[..., 2] = np.maximum(x[..., 2], 2.5e-4)
    return x


def both_ways(mechanics: Mechanics, level: Level) -> tuple[Array, Array]:
    """The exact Hessian at :func:`roomy` and the differences of the gradient there [N/m]."""
    rig = rig_with(mechanics, level)
    return rig.hessian(roomy()), differences(level, roomy(), HELD)


@pytest.fixture(scope="module")
def baseline(level: Level) -> tuple[Array, Array]:
    return both_ways(Mechanics(), level)


@pytest.fixture(scope="module")
def everything(level: Level) -> tuple[Array, Array]:
    return both_ways(HOOKS["everything"], level)


def test_exact_hessian_is_the_derivative_of_the_gradient(baseline: tuple[Array, Array]) -> None:
    """To 3e-7 N/m: the membrane's largest entry is 2.9e3, that of bending about 1."""
    exact, numeric = baseline
    assert relative(numeric, exact) < 1e-10
    assert np.abs(exact - exact.T).max() == 0.0


@pytest.mark.parametrize("hook", sorted(set(HOOKS) - {"baseline", *NO_STIFFNESS}))
def test_what_a_hook_adds_to_the_hessian_is_the_derivative_of_what_it_adds_to_the_gradient(
    hook: str, level: Level, baseline: tuple[Array, Array]
) -> None:
    """Relative to the largest entry that it adds, 0.4 N/m of friction to 3e6 of stiffening.

    Rounding of the differences is 1.4e-8 of that at most (friction); a Hessian without the hook would be wrong by 1.
    """
    exact, numeric = both_ways(HOOKS[hook], level)
    assert relative(exact - baseline[0], numeric - baseline[1]) < 1e-7
    assert np.abs(exact - exact.T).max() == 0.0


@pytest.mark.parametrize("part", PARTS)
def test_among_all_others_a_part_adds_the_derivative_of_what_it_adds_to_the_gradient(
    part: str, level: Level, everything: tuple[Array, Array]
) -> None:
    """Beside stiffening, whose entries reach 1.2e6 N/m, rounding is 4.4e-6 of what friction adds, 0.3 N/m."""
    without = both_ways(replace(HOOKS["everything"], **{part: getattr(Mechanics(), part)}), level)
    assert relative(everything[0] - without[0], everything[1] - without[1]) < 2e-5


@pytest.mark.parametrize("hook", NO_STIFFNESS)
def test_what_pulls_alike_everywhere_adds_nothing_to_the_hessian(
    hook: str, level: Level, baseline: tuple[Array, Array]
) -> None:
    exact, numeric = both_ways(HOOKS[hook], level)
    assert np.array_equal(exact, baseline[0])
    assert np.abs(numeric - baseline[1]).max() < 1e-7  # N/m


def test_gradient_is_the_derivative_of_the_energy_that_the_kernels_give(level: Level) -> None:
    rig = rig_of("everything", level)
    x = crumpled(GRID, 22)
    gradient = level.gradient(x)
    assert relative(gradient, complex_step_gradient(rig.cloth, x)) < 1e-9
    rng = np.random.default_rng(0)
    for _ in range(5):
        d = 1e-7 * rng.standard_normal(x.shape) * ~HELD[..., None]
        along = (
            8 * (level.energy(x + d) - level.energy(x - d)) - level.energy(x + 2 * d) + level.energy(x - 2 * d)
        ) / 12
        assert along == pytest.approx(np.vdot(gradient, d), rel=1e-6)


@pytest.mark.parametrize("hook", HOOKS)
def test_blend_zero_has_no_negative_curvature_and_blends_are_straight_lines(hook: str, level: Level) -> None:
    rig = rig_of(hook, level)
    for seed in (31, 32):
        x = crumpled(GRID, seed)
        positive = rig.hessian(x, 0.0)
        values = np.linalg.eigvalsh(positive)
        assert values[0] > -1e-10 * values[-1]
        assert np.linalg.eigvalsh(rig.hessian(x, 1.0))[0] < 0.0  # there was something to take out
        # blended by halves it lies between: nowhere below the exact one
        middle, exact = rig.hessian(x, 0.5), rig.hessian(x, 1.0)
        assert np.abs(middle - 0.5 * (positive + exact)).max() < 1e-9 * np.abs(exact).max()


def test_held_vertices_are_out_of_the_matrix(level: Level) -> None:
    from .rigs import assembled

    rig_of("baseline", level)
    dense = assembled(level, crumpled(GRID, 3), 1.0)
    held = np.flatnonzero(np.repeat(HELD.ravel(), 3))
    block = dense[held]
    assert np.array_equal(block[:, held], np.eye(len(held)) * block[0, held[0]])
    block[:, held] = 0.0
    assert not block.any()


@pytest.mark.parametrize("seed", range(4))
def test_inertia_of_the_factorisation_is_the_count_of_negative_eigenvalues(seed: int) -> None:
    grid = Grid(9, 11, 0.02, 0.02)
    level = Level(grid)
    held = np.zeros((9, 11), dtype=bool)
    held[0, [0, -1]] = True
    from .rigs import FABRICS, Rig

    rig = Rig.of(level, FABRICS["soft"], held)
    x = crumpled(grid, seed, 0.02 * (seed + 1))
    for blend in (0.0, 0.3, 1.0):
        values = np.linalg.eigvalsh(rig.hessian(x, blend))
        assert level.factor(x, blend) == int((values < 0.0).sum())
    # and its solution solves
    right = np.random.default_rng(seed).standard_normal(grid.shape) * ~held[..., None]
    free = np.repeat(~held.ravel(), 3)
    expected = np.linalg.solve(rig.hessian(x), right.ravel()[free])
    level.factor(x, 1.0)
    assert relative(level.solve(right).ravel()[free], expected) < 1e-8


def test_soft_modes_are_the_eigenvectors_nearest_zero() -> None:
    grid = Grid(6, 7, 0.02, 0.02)
    level = Level(grid)
    held = np.zeros((6, 7), dtype=bool)
    held[0] = True
    from .rigs import FABRICS, Rig

    rig = Rig.of(level, FABRICS["medium"], held)
    x = crumpled(grid, 2, 0.01)
    values = np.linalg.eigvalsh(rig.hessian(x))
    nearest = np.sort(values[np.argsort(np.abs(values))[:3]])
    level.factor(x, 1.0)
    start = np.random.default_rng(0).standard_normal((8, 3 * 42))
    found, vectors = level.soft_modes(8, start, 60)
    closest = np.sort(found[np.argsort(np.abs(found))[:3]])
    assert closest == pytest.approx(nearest, rel=1e-3)
    assert np.linalg.norm(vectors, axis=1) == pytest.approx(np.ones(8))
    assert not vectors.reshape(8, -1, 3)[:, held.ravel()].any()  # an escape along one leaves magnets where they are


@pytest.mark.parametrize("single", [False, True])
def test_factors_that_were_given_back_are_made_again_with_the_same_bits(single: bool) -> None:
    indptr, indices = np.array([0, 2, 4, 5], dtype=np.int32), np.array([0, 1, 1, 2, 2], dtype=np.int32)
    values, right = np.array([4.0, 1.0, 3.0, -1.0, 2.0]), np.array([1.0, 2.0, 3.0])
    kept = Factorisation(indptr, indices, single)
    assert kept.factor(values) == 0
    first = kept.solve(right)
    kept.forget()
    kept.forget()
    assert kept.factor(values) == 0
    np.testing.assert_array_equal(kept.solve(right), first)
    np.testing.assert_allclose([[4, 1, 0], [1, 3, -1], [0, -1, 2]] @ first, right, rtol=1e-5)
