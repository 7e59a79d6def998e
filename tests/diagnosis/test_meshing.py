"""Samples that no whole number of cells fits are simulated a little larger or smaller, held as tight."""

from __future__ import annotations

from dataclasses import replace

import pytest

from diagnosis.simulation.variations import other_radius_m
from diagnosis.tasks.meshing import cell_size, on_cells
from simcore.errors import InputError
from simcore.mesh import GridMesh
from simcore.scenes import Setup


@pytest.mark.parametrize("wanted", [0.005, 0.01, 0.02])
def test_a_sample_that_cells_divide_keeps_its_size(wanted: float) -> None:
    setup = Setup.nominal("stretch")
    assert cell_size(setup.sample_size_m, wanted) == pytest.approx(wanted, rel=1e-12)
    assert on_cells(setup, wanted) is setup


@pytest.mark.parametrize("size", [(0.503, 0.498), (0.5, 0.498), (0.4999, 0.5), (0.42, 0.297), (0.21, 0.297)])
def test_a_sample_cut_by_hand_gets_whole_cells_near_the_wanted_one(size: tuple[float, float]) -> None:
    setup = Setup.nominal("stretch", sample_size_m=size)
    cell = cell_size(size, 0.01)
    whole = on_cells(setup, cell)
    assert 0.008 <= cell <= 0.0125
    assert GridMesh(cell, whole.sample_size_m).vertex_count > 0
    assert whole.sample_size_m == pytest.approx(size, abs=0.0026)  # half of what the edges of the first differ by


@pytest.mark.parametrize("size", [(0.35, 0.35), (0.45, 0.3), (0.25, 0.25), (0.3, 0.4), (0.55, 0.55)])
def test_fine_cells_are_even_in_number_so_that_a_mesh_of_half_as_many_fits(size: tuple[float, float]) -> None:
    cell = cell_size(size, 0.01)
    counts = [edge / cell for edge in size]
    assert counts == pytest.approx([2 * round(count / 2) for count in counts])
    assert 0.009 < cell < 0.0111


def test_where_cells_fit_as_well_as_a_sample_is_cut_the_size_changes_by_less() -> None:
    assert on_cells(
        Setup.nominal("hanging", sample_size_m=(0.42, 0.297)), cell_size((0.42, 0.297), 0.01)
    ).sample_size_m == (pytest.approx((0.42, 0.297), abs=0.0005))


def test_pins_move_with_the_sample_so_that_it_is_held_as_tight() -> None:
    setup = Setup.nominal("stretch", sample_size_m=(0.503, 0.498)).with_pins(top_left=(-0.24, 0.001, 0.002))
    whole = on_cells(setup, cell_size(setup.sample_size_m, 0.01))
    for name, place in setup.pins_m.items():
        for axis in (0, 1):
            now, before = whole.pins_m[name][axis], place[axis]
            assert now / whole.sample_size_m[axis] == pytest.approx(before / setup.sample_size_m[axis])
        assert whole.pins_m[name][2] == place[2]
    assert whole.pin_radius_m == setup.pin_radius_m


@pytest.mark.parametrize("edge", [0.501, 0.503, 0.508, 0.305, 0.495])
def test_magnets_of_a_cell_hold_a_patch_on_cells_that_are_a_little_larger(edge: float) -> None:
    setup = Setup.nominal("hanging", sample_size_m=(edge, edge))
    cell = cell_size((edge, edge), 0.01)
    held = on_cells(setup, cell)
    assert cell <= held.pin_radius_m < 1.2 * cell  # the corner and its neighbours
    assert other_radius_m(held, cell) == 0.0
    assert cell <= other_radius_m(replace(held, pin_radius_m=0.0), cell) < 1.2 * cell


def test_a_coarse_mesh_that_no_edge_fits_is_refused() -> None:
    with pytest.raises(InputError) as caught:
        cell_size((0.5, 0.13), 0.1)
    assert caught.value.code == "resolution_does_not_divide"


def test_a_second_sample_of_another_size_is_refused_where_its_fabric_has_other_cells() -> None:
    with pytest.raises(InputError, match="give samples of two sizes as two fabrics"):
        on_cells(Setup.nominal("hanging", sample_size_m=(0.21, 0.144)), 0.01)


@pytest.mark.parametrize("wanted", [0.0, -0.01, 0.0005, 1e-5, 0.2, float("nan"), float("inf")])
def test_cells_that_no_diagnosis_can_use_are_refused_at_once(wanted: float) -> None:
    with pytest.raises(InputError) as caught:
        cell_size((0.5, 0.5), wanted)
    assert caught.value.code == "resolution_out_of_range"
