"""Finer meshes give the same drape: energy and shape from 20 to 10 to 5 mm."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.drape import Drape
from simcore.mechanics import NO_JITTER
from simcore.mesh import GridMesh
from simcore.scenes import Scene, Setup
from simcore.solver import Solver

from .judge import cloth_of, positions
from .rigs import FABRICS

SETUP = Setup.nominal(Scene.HANGING, pin_radius_m=0.02)  # a patch that every mesh has: the corner and its neighbours
FABRIC = FABRICS["vstiff"]


@pytest.fixture(scope="module")
def refined(solver: Solver) -> list[Drape]:
    solvers = [solver, Solver(GridMesh(0.01)), Solver(GridMesh(0.005))]
    return [s.solve(FABRIC, SETUP, jitter=NO_JITTER) for s in solvers]


def test_energy_converges(refined: list[Drape]) -> None:
    assert all(d.ok for d in refined)
    coarse, middle, fine = (d.energy for d in refined)
    assert abs(fine - middle) < 0.5 * abs(middle - coarse)
    assert fine == pytest.approx(coarse, rel=0.01)


def test_shape_converges(refined: list[Drape]) -> None:
    coarse, middle, fine = (positions(d) for d in refined)
    first = np.sqrt(np.mean((coarse - fine[::4, ::4]) ** 2))
    second = np.sqrt(np.mean((middle - fine[::2, ::2]) ** 2))
    assert second < 0.6 * first
    assert second < 1e-3


def test_the_finest_is_at_rest_too(refined: list[Drape]) -> None:
    assert cloth_of(refined[2], FABRIC, SETUP, jitter=NO_JITTER).residual(positions(refined[2])) < 1e-3
