"""Cloth that would pass through itself: energies, derivatives, and a drape that touches itself."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from simcore.closest import on_edges, on_triangles
from simcore.crossings import count_crossings
from simcore.grid import Grid
from simcore.mesh import GridMesh, grid_triangles
from simcore.parameters import FabricParameters
from simcore.scenes import Scene, Setup
from simcore.self_contact import APART, TUCKED, SelfContact
from simcore.solver import Solver

from .judge import cloth_of, lowest_stiffness, positions
from .reference_self_contact import contacts, measures, own_contact_energy, own_contact_gradient

GRID = Grid(9, 21, 0.02, 0.02)
FINE = Grid(11, 17, 0.008, 0.0095)
"""Reach: a fifth of the shorter side."""
FREE = np.zeros((9, 21), dtype=np.int32)
WEIGHT = 1e-3


def folded(gap: float, grid: Grid = GRID, seed: int = 3) -> np.ndarray:
    """A sheet folded over itself with its halves ``gap`` apart, a little askew."""
    x = grid.rest.copy()
    middle = grid.columns // 2
    over, line = np.arange(grid.columns) > middle, grid.rest[:, middle, 0][:, None]
    x[:, over, 0] = line - (grid.rest[:, over, 0] - line) + 0.15 * grid.hu
    x[:, over, 2] = gap
    x[:, over, 1] += 0.2 * grid.hv
    rng = np.random.default_rng(seed)
    return x + 0.005 * grid.hu * rng.standard_normal(x.shape)


def test_closest_points_are_no_farther_than_any_others() -> None:
    rng = np.random.default_rng(0)
    points, corners = rng.standard_normal((300, 3)), rng.standard_normal((300, 3, 3))
    shares = on_triangles(points, corners)
    assert (shares >= -1e-12).all() and shares.sum(axis=1) == pytest.approx(np.ones(300))
    found = np.linalg.norm(points - np.einsum("nk,nkc->nc", shares, corners), axis=1)
    tried = rng.dirichlet(np.ones(3), 4000)
    others = np.linalg.norm(points[:, None] - np.einsum("mk,nkc->nmc", tried, corners), axis=2).min(axis=1)
    assert (found <= others + 1e-12).all() and (found >= others - 0.15).all()
    first, second = corners[:, :2], rng.standard_normal((300, 2, 3))
    s, t = on_edges(first, second)
    found = np.linalg.norm(first[:, 0] + s[:, None] * (first[:, 1] - first[:, 0])
                           - second[:, 0] - t[:, None] * (second[:, 1] - second[:, 0]), axis=1)  # fmt: skip
    a, b = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41)))
    ones = first[:, :1] + a[None, :, None] * (first[:, 1:] - first[:, :1])
    twos = second[:, :1] + b[None, :, None] * (second[:, 1:] - second[:, :1])
    others = np.linalg.norm(ones - twos, axis=2).min(axis=1)
    assert (found <= others + 1e-12).all() and (found >= others - 0.1).all()


def test_a_sheet_by_itself_and_parts_out_of_reach_cost_nothing() -> None:
    for x in (GRID.rest, folded(0.006)):
        contact = SelfContact(GRID, WEIGHT, FREE)
        gradient = np.zeros(GRID.shape)
        contact.add_gradient(x, gradient)
        assert contact.energy(x) == 0.0 and not gradient.any() and contact.hessian(x) is None


def test_the_nearer_the_dearer_and_through_is_forbidden() -> None:
    energies = [SelfContact(GRID, WEIGHT, FREE).energy(folded(gap)) for gap in (0.0018, 0.0015, 0.0012)]
    assert 0.0 < energies[0] < energies[1] < energies[2] < math.inf
    tilted = folded(0.003)
    tilted[:, 11:, 2] -= 0.03 * (np.arange(10) / 10)
    assert count_crossings(tilted.reshape(-1, 3), grid_triangles(9, 21)) > 0
    assert SelfContact(GRID, WEIGHT, FREE).energy(tilted) == math.inf
    assert own_contact_energy(tilted, 0.02, 0.02, WEIGHT) == math.inf


def test_pairs_are_looked_at_in_parts_that_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a cell is far stretched a million pairs lie near each other; all at once they took half a gigabyte."""
    touching, crossing = folded(0.0012), folded(0.003)
    crossing[:, 11:, 2] -= 0.03 * (np.arange(10) / 10)
    found = []
    for part in (1_000_000, 7):
        monkeypatch.setattr("simcore.self_contact.PART", part)
        contact, gradient = SelfContact(GRID, WEIGHT, FREE), np.zeros(GRID.shape)
        contact.add_gradient(touching, gradient)
        found.append((contact.energy(touching), gradient, SelfContact(GRID, WEIGHT, FREE).energy(crossing)))
    whole, parts = found
    assert whole[0] == parts[0] > 0.0
    assert (whole[1] == parts[1]).all() and whole[1].any()
    assert whole[2] == parts[2] == math.inf


@pytest.mark.parametrize("grid", [GRID, FINE])
@pytest.mark.parametrize("share", [0.9, 0.7, 0.55])
def test_energy_and_gradient_are_those_of_the_reference(grid: Grid, share: float) -> None:
    reach, _ = measures(grid.hu, grid.hv, WEIGHT)
    assert reach == pytest.approx(min(2e-3, 0.2 * min(grid.hu, grid.hv)))
    held = np.zeros(grid.shape[:2], dtype=np.int32)
    held[:2, -3:] = 1
    for seed in range(2):
        x = folded(share * reach, grid, seed)
        contact, gradient = SelfContact(grid, WEIGHT, held), np.zeros(grid.shape)
        contact.add_gradient(x, gradient)
        expected = own_contact_gradient(x, grid.hu, grid.hv, WEIGHT)
        assert np.abs(expected[held == 1]).max() > 0.0 and not gradient[held == 1].any()
        expected[held == 1] = 0.0
        assert contact.energy(x) == pytest.approx(own_contact_energy(x, grid.hu, grid.hv, WEIGHT), rel=1e-9)
        assert np.abs(gradient - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("grid", [GRID, FINE])
def test_the_reference_is_the_derivative_of_its_own_energy(grid: Grid) -> None:
    x = folded(0.7 * measures(grid.hu, grid.hv, WEIGHT)[0], grid)
    gradient = own_contact_gradient(x, grid.hu, grid.hv, WEIGHT)
    rng = np.random.default_rng(4)
    for _ in range(3):
        along = rng.standard_normal(grid.shape)
        slope = own_contact_energy(x + 1e-30j * along, grid.hu, grid.hv, WEIGHT).imag / 1e-30
        assert slope == pytest.approx(float(np.vdot(gradient, along)), rel=1e-10)


def test_a_vertex_over_a_cell_costs_what_the_formula_says() -> None:
    """One pair by hand: the sheet folded over, well above itself but for the corner, whose tip comes down on a cell."""
    x = GRID.rest.copy()
    x[:, :7, 0] = 2.0 * GRID.rest[0, 7, 0] - GRID.rest[:, :7, 0]
    x[:, :7, 2], x[:, 7, 2] = 0.03, 0.015
    triangle = x[[1, 1, 2], [14, 15, 14]]  # of a cell with j + i odd: its corner and the two next to it
    x[0, 0] = triangle.mean(axis=0) + np.array([0.0, 0.0, 0.0013])
    near = contacts(x, 2e-3)
    assert len(near.weights) == 1
    expected = -5.0 * WEIGHT * 2e-3 * (0.65 - 1.0) ** 2 * math.log(0.65)
    assert own_contact_energy(x, 0.02, 0.02, WEIGHT) == pytest.approx(expected, rel=1e-12)
    assert SelfContact(GRID, WEIGHT, FREE).energy(x) == pytest.approx(expected, rel=1e-12)
    push = -own_contact_gradient(x, 0.02, 0.02, WEIGHT)[0, 0]
    slope = 5.0 * WEIGHT * (2 * (0.65 - 1.0) * math.log(0.65) + (0.65 - 1.0) ** 2 / 0.65)
    assert push == pytest.approx([0.0, 0.0, slope], rel=1e-9, abs=1e-15)


def test_gradient_is_the_derivative_and_the_hessian_its_main_part() -> None:
    x = folded(0.0014)
    held = FREE.copy()
    held[0] = 1
    contact = SelfContact(GRID, WEIGHT, held)
    gradient = np.zeros(GRID.shape)
    contact.add_gradient(x, gradient)
    assert not gradient[0].any()
    rng = np.random.default_rng(1)
    along = rng.standard_normal(GRID.shape) * (held == 0)[..., None]
    step = 1e-8
    measured = (contact.energy(x + step * along) - contact.energy(x - step * along)) / (2.0 * step)
    assert measured == pytest.approx(float(np.vdot(gradient, along)), rel=1e-6)
    hessian = contact.hessian(x)
    assert hessian is not None
    values = np.linalg.eigvalsh(hessian.toarray())
    assert values.min() > -1e-9 * values.max()
    flat = np.zeros(GRID.shape)
    flat[:, 11:, 2] = 1.0  # apart along the normals, nothing turns
    flat *= (held == 0)[..., None]
    ahead, behind = np.zeros(GRID.shape), np.zeros(GRID.shape)
    contact.add_gradient(x + 1e-7 * flat, ahead)
    contact.add_gradient(x - 1e-7 * flat, behind)
    measured = float(np.vdot(flat, ahead - behind)) / 2e-7
    assert measured == pytest.approx(float(flat.ravel() @ (hessian @ flat.ravel())), rel=0.05)


def tucked(across: float) -> np.ndarray:
    """A sheet folded back on itself within two cells, column 11 so many cells over, or under, the cells before 10."""
    x = GRID.rest.copy()
    shape = {10: (1.0, 0.0), 11: (0.42, across), 12: (0.42, 1.0), 13: (1.4, 1.0)}
    for column in range(10, GRID.columns):
        along, up = shape.get(column, (column - 11.6, 1.0))
        x[:, column, 0], x[:, column, 2] = GRID.rest[:, 9, 0] + GRID.hu * along, GRID.hu * up
    x[:, 11:, 1] += 0.3 * GRID.hv
    return x


@pytest.mark.parametrize(("apart", "sees"), [(APART, False), (TUCKED, True)])
def test_a_tuck_of_two_cells_is_seen_where_parts_one_cell_apart_keep_off_each_other(apart: int, sees: bool) -> None:
    near, through = tucked(0.03), tucked(-0.3)
    assert count_crossings(near.reshape(-1, 3), grid_triangles(9, 21)) == 0
    assert count_crossings(through.reshape(-1, 3), grid_triangles(9, 21)) > 0
    contact, gradient = SelfContact(GRID, WEIGHT, FREE, apart), np.zeros(GRID.shape)
    contact.add_gradient(near, gradient)
    assert bool(contact.energy(near) > 0.0) is sees and bool(gradient.any()) is sees
    assert contact.energy(near) == pytest.approx(own_contact_energy(near, 0.02, 0.02, WEIGHT, apart), rel=1e-9)
    expected = own_contact_gradient(near, 0.02, 0.02, WEIGHT, cells=apart)
    assert np.abs(gradient - expected).max() <= 1e-9 * np.abs(expected).max()
    assert math.isinf(SelfContact(GRID, WEIGHT, FREE, apart).energy(through)) is sees
    assert math.isinf(own_contact_energy(through, 0.02, 0.02, WEIGHT, apart)) is sees


def test_parts_one_cell_apart_of_a_sheet_by_itself_cost_nothing() -> None:
    assert SelfContact(GRID, WEIGHT, FREE, TUCKED).energy(GRID.rest) == 0.0
    assert SelfContact(FINE, WEIGHT, np.zeros((11, 17), np.int32), TUCKED).energy(FINE.rest) == 0.0


def test_momentum_is_kept() -> None:
    contact = SelfContact(GRID, WEIGHT, FREE)
    gradient = np.zeros(GRID.shape)
    contact.add_gradient(folded(0.0013), gradient)
    assert np.abs(gradient).max() > 0.0
    assert gradient.sum(axis=(0, 1)) == pytest.approx(np.zeros(3), abs=1e-12 * np.abs(gradient).max() * gradient.size)


def test_a_drape_that_would_pass_through_itself_rests_on_itself_instead() -> None:
    solver = Solver(GridMesh(0.02))
    soft, setup = FabricParameters(300, 200, 100, 1e-6, 1e-6, 1e-6, 0.2), Setup.nominal(Scene.HANGING)
    for seed in (7, 4, *range(20, 30)):  # which seeds' folds meet differs between processors
        drape = solver.solve(soft, setup, seed=seed, time_limit_s=60.0)
        contact = solver.levels[-1].own_contact
        if drape.ok and contact is not None:
            assert count_crossings(drape.vertices, solver.mesh.triangles) == 0
            assert drape.stable and drape.residual < 1e-3
            cloth, x = cloth_of(drape, soft, setup, seed=seed, own_contact=contact.apart), positions(drape)
            assert cloth.residual(x) < 1e-3
            assert cloth.residual(x) == pytest.approx(drape.residual, rel=1e-3, abs=1e-7)
            assert cloth.energy(x) == pytest.approx(drape.energy, rel=1e-9)
            assert lowest_stiffness(cloth, x) > -1e-6
            without = replace(cloth, own_contact=0)  # it does rest on itself
            assert without.residual(x) > 10.0 * cloth.residual(x)
            assert without.energy(x) < cloth.energy(x)
            return
    pytest.fail("no seed made the cloth touch itself: choose another fabric")


def test_a_point_that_folds_run_into_does_not_poke_through() -> None:
    """A fabric of the prior whose drape on 10 mm cells crossed itself within two cells, and was flagged."""
    fabric = FabricParameters(87.73, 479.69, 71.969, 4.7205e-06, 9.1882e-06, 3.10306e-06, 0.17247)
    solver = Solver(GridMesh(0.01))
    drape = solver.solve(fabric, Setup.nominal(Scene.HANGING), seed=335)
    assert drape.ok and count_crossings(drape.vertices, solver.mesh.triangles) == 0
