"""Folds that the mesh resists rather than the fabric."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simcore import resolution
from simcore.cloths import Cloths
from simcore.drape import DrapeStatus
from simcore.grid import Grid
from simcore.mechanics import Mechanics
from simcore.mesh import GridMesh
from simcore.newton import Rest
from simcore.parameters import FabricParameters
from simcore.resolution import LARGEST_RESISTANCE, mesh_resistance
from simcore.scenes import Scene, Setup
from simcore.solver import Solver
from simcore.verdict import verdict

from .reference import Cloth
from .rigs import ANISOTROPIC, FABRICS, crumpled, cylinder, fields_of, laid_out

GRID = Grid(41, 51, 0.01, 0.01)
FREE = np.zeros((41, 51), bool)
STIFF_AND_LIMP = FabricParameters(3000, 3000, 1000, 1e-6, 1e-6, 1e-6, 0.1)
"""On 10 mm cells a third of its bending moves the drape by less than 2 mm."""


def dimples(rows: slice = slice(None), columns: slice = slice(None), height_m: float = 0.004) -> np.ndarray:
    """A flat sheet with dimples three cells apart in some of its rows and columns, in panel coordinates."""
    x = laid_out(GRID, [1, 0, 0], [0, -1, 0])
    j, i = np.mgrid[0:41, 0:51]
    x[rows, columns, 2] = (height_m * np.sin(2.1 * j) * np.sin(2.1 * i))[rows, columns]
    return x


def scaled(fabric: FabricParameters, stretch: float, bending: float) -> FabricParameters:
    k = {name: stretch * getattr(fabric, name) for name in ("stretch_warp", "stretch_weft", "stretch_bias")}
    b = {name: bending * getattr(fabric, name) for name in ("bending_warp", "bending_weft", "bending_bias")}
    return replace(fabric, **k, **b)


@pytest.mark.parametrize("off_grain_rad", [0.0, 0.3])
def test_energies_are_those_of_the_reference(monkeypatch: pytest.MonkeyPatch, off_grain_rad: float) -> None:
    grid, mechanics = Grid(13, 17, 0.01, 0.011), Mechanics(off_grain_rad=off_grain_rad)
    held = np.zeros((13, 17), bool)
    held[3, 5:7] = True
    x, cloth = crumpled(grid, 3), fields_of(grid, ANISOTROPIC, held, mechanics)
    reference = Cloth(ANISOTROPIC, grid.hu, grid.hv, held, mechanics, panel=False)
    assert resolution._bending_energy(x, cloth) == pytest.approx(float(reference.bending_energy(x)), rel=1e-10)
    whole = float(reference.membrane_energy(x))
    monkeypatch.setattr(Cloth, "_hourglass", lambda self: 0.0)
    hourglass = whole - float(reference.membrane_energy(x))
    assert hourglass > 0.01 * whole
    assert resolution._hourglass_energies(x, cloth).sum() == pytest.approx(hourglass, rel=1e-9)


@pytest.mark.parametrize("heading_deg", [0.0, 90.0])
def test_flat_and_rolled_sheets_are_not_resisted(heading_deg: float) -> None:
    cloth = fields_of(GRID, STIFF_AND_LIMP, FREE)
    assert mesh_resistance(laid_out(GRID, [1, 0, 0], [0, -1, 0]), cloth) == 0.0
    assert mesh_resistance(cylinder(GRID, 0.03, np.radians(heading_deg)), cloth) < 1e-12


def test_a_sheet_strained_in_its_plane_is_flat() -> None:
    x = laid_out(GRID, [1, 0, 0], [0, -1, 0])
    x[..., 0] += 0.5 * x[..., 0] * x[..., 1]  # each row is stretched otherwise: cells are trapezia
    cloth = fields_of(GRID, STIFF_AND_LIMP, FREE)
    assert resolution._hourglass_energies(x, cloth).sum() > 1e-5
    assert mesh_resistance(x, cloth) == 0.0


def test_it_goes_by_stretch_over_bending_stiffness() -> None:
    x = dimples()
    one = mesh_resistance(x, fields_of(GRID, ANISOTROPIC, FREE))
    assert one > 0.0
    assert mesh_resistance(x, fields_of(GRID, scaled(ANISOTROPIC, 3.0, 1.0), FREE)) == pytest.approx(3.0 * one)
    assert mesh_resistance(x, fields_of(GRID, scaled(ANISOTROPIC, 1.0, 0.1), FREE)) == pytest.approx(10.0 * one)


def test_cells_near_a_magnet_do_not_count() -> None:
    held = FREE.copy()
    held[20, 10] = True
    cloth = fields_of(GRID, STIFF_AND_LIMP, held)
    # vertices within 50 mm are near, and so are the cells at whose corners they lie
    assert mesh_resistance(dimples(slice(16, 25), slice(6, 15)), cloth) == 0.0
    assert mesh_resistance(dimples(slice(16, 25), slice(15, 24)), cloth) > 0.0


def told(x: np.ndarray, cloth: Cloths, cells_m: float = 0.01) -> tuple[DrapeStatus, str]:
    return verdict(GridMesh(cells_m), cloth, Rest(x, 1e-4, True, 12, True), 0, late=False)


def test_what_the_mesh_resists_is_flagged_with_the_reason() -> None:
    x = dimples(height_m=0.0016)  # turns of less than 45 degrees
    one = mesh_resistance(x, fields_of(GRID, ANISOTROPIC, FREE))
    for times, status in ((0.98, DrapeStatus.STILL), (1.02, DrapeStatus.UNDER_RESOLVED)):
        fabric = scaled(ANISOTROPIC, times * LARGEST_RESISTANCE / one, 1.0)
        assert told(x, fields_of(GRID, fabric, FREE))[0] is status
    _, reason = told(x, fields_of(GRID, scaled(ANISOTROPIC, 3.0 / one, 1.0), FREE))
    assert reason.startswith("the mesh resists the folds 3 times as much as the fabric's bending does: ")
    assert reason.endswith("use a mesh finer than 10 mm")


def test_previews_are_not_judged_by_it() -> None:
    grid = Grid(41, 51, 0.0125, 0.0125)
    x = 1.25 * dimples(height_m=0.0016)
    cloth = fields_of(grid, STIFF_AND_LIMP, FREE)
    assert mesh_resistance(x, cloth) > 3.0 * LARGEST_RESISTANCE
    assert told(x, cloth, 0.0125) == (DrapeStatus.STILL, "")


def test_the_solver_tells_a_fabric_that_its_mesh_cannot_carry() -> None:
    solver = Solver(GridMesh(0.01))
    setup = Setup.nominal(Scene.HANGING)
    drape = solver.solve(STIFF_AND_LIMP, setup)
    assert drape.status is DrapeStatus.UNDER_RESOLVED and not drape.ok
    assert drape.stable and drape.residual < 1e-3  # at rest all the same
    assert "resists the folds" in drape.reason and "finer than 10 mm" in drape.reason
    assert solver.solve(FABRICS["medium"], setup).ok
