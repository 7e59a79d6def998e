"""Folds that a mesh can and cannot carry."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from simcore.cloths import Cloths
from simcore.drape import DrapeStatus
from simcore.grid import Grid
from simcore.mesh import GridMesh
from simcore.newton import Rest
from simcore.parameters import FabricParameters
from simcore.resolution import SHARP_RAD, kinked_share
from simcore.verdict import verdict

from .rigs import fields_of

BOARD = FabricParameters(100, 100, 100, 1e-2, 1e-2, 1e-2, 0.2)
"""So rigid that no mesh resists its folds."""


def wave(cells: float, steepest: float, rows: int = 81, columns: int = 121) -> np.ndarray:
    """A sheet with a wave of so many cells along its rows; at its crests it turns by ``steepest`` a cell."""
    v, u = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    k = 2.0 * math.pi / cells
    return np.stack([u, -v, steepest / k**2 * np.sin(k * u)], axis=2).astype(np.float64)


def test_smooth_and_flat_sheets_have_no_kinks() -> None:
    assert kinked_share(wave(20.0, 0.5 * SHARP_RAD)) == 0.0
    assert kinked_share(wave(20.0, 0.0)) == 0.0


@pytest.mark.parametrize("axis", [0, 1])
def test_zigzag_of_the_mesh_is_all_kinks(axis: int) -> None:
    x = wave(20.0, 0.0)
    x[..., 2] = 0.5 * (-1.0) ** np.arange(x.shape[axis]).reshape((-1, 1) if axis == 0 else (1, -1))
    assert kinked_share(x) == 1.0


def test_a_single_sharp_crease_is_its_share() -> None:
    x = wave(20.0, 0.0)
    x[:, 60:, 2] = 2.0 * np.arange(61)
    assert kinked_share(x) == pytest.approx(1 / 119)


def rested(x: np.ndarray, cells_m: float) -> Rest:
    """A certified rest on cells of this size; ``x`` in cells."""
    return Rest(cells_m * x, 1e-4, stable=True, iterations=12, converged=True)


def board(x: np.ndarray, cells_m: float) -> Cloths:
    """The fields of a sheet as large as ``x``, held nowhere."""
    grid = Grid(x.shape[0], x.shape[1], cells_m, cells_m)
    return fields_of(grid, BOARD, np.zeros(x.shape[:2], bool))


def judged(x: np.ndarray, cells_m: float) -> tuple[DrapeStatus, str]:
    """Of a certified rest that crosses nothing."""
    return verdict(GridMesh(cells_m), board(x, cells_m), rested(x, cells_m), 0, late=False)


def zigzag(share: float) -> np.ndarray:
    """A sheet of which this share of the rows turns by a right angle at every vertex."""
    x = wave(20.0, 0.0, rows=100)
    x[: round(100 * share), :, 2] = 0.5 * (-1.0) ** np.arange(x.shape[1])
    assert kinked_share(x) == pytest.approx(share)
    return x


@pytest.mark.parametrize(("cells_m", "most"), [(0.005, 0.04), (0.01, 0.04), (0.0125, 0.25), (0.02, 0.25), (0.05, 0.25)])
def test_a_drape_that_the_mesh_cannot_carry_is_flagged(cells_m: float, most: float) -> None:
    assert judged(wave(20.0, 0.0), cells_m) == (DrapeStatus.STILL, "")
    assert judged(zigzag(most - 0.01), cells_m) == (DrapeStatus.STILL, "")
    for share in (most + 0.01, 1.0):
        status, reason = judged(zigzag(share), cells_m)
        assert status is DrapeStatus.UNDER_RESOLVED
        assert f"{100 * share:.0f} %" in reason and f"finer than {1e3 * cells_m:g} mm" in reason


def test_what_is_worse_than_kinks_is_said_first() -> None:
    mesh, folded = GridMesh(0.01), rested(zigzag(1.0), 0.01)
    cloth = board(folded.x, 0.01)
    status, reason = verdict(mesh, cloth, folded, 3, late=False)
    assert status is DrapeStatus.NOT_STILL and "through itself: 3 edges" in reason
    moving = replace(folded, converged=False, stable=False, residual=0.2)
    status, reason = verdict(mesh, cloth, moving, 3, late=False)
    assert status is DrapeStatus.NOT_STILL and reason == "residual 0.2 vertex weights after 12 steps"
    assert verdict(mesh, cloth, moving, 3, late=True) == (DrapeStatus.NOT_STILL, f"time limit; {reason}")
    late = verdict(mesh, cloth, replace(moving, residual=1e-5), 0, late=True)[1]
    assert late == "time limit; residual 1e-05 vertex weights after 12 steps"
    for stable, said in ((False, "saddle"), (True, "friction")):
        status, reason = verdict(mesh, cloth, replace(moving, residual=1e-5, stable=stable), 0, late=False)
        assert status is DrapeStatus.NOT_STILL and said in reason
    for gone in (replace(moving, x=np.full_like(folded.x, np.nan)), replace(moving, residual=math.nan)):
        assert verdict(mesh, cloth, gone, 0, late=True)[0] is DrapeStatus.DIVERGED
