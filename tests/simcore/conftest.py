"""Drapes that several tests judge; one solver for all of them."""

from __future__ import annotations

import pytest

from simcore.drape import Drape
from simcore.mesh import GridMesh
from simcore.scenes import Scene, Setup
from simcore.solver import Solver

from .rigs import FABRICS

CASES = [(name, scene) for name in FABRICS for scene in Scene]


@pytest.fixture(scope="session")
def solver() -> Solver:
    """20 mm cells: a drape takes a fraction of a second."""
    return Solver(GridMesh(0.02))


@pytest.fixture(scope="session")
def drapes(solver: Solver) -> dict[tuple[str, Scene], Drape]:
    """Each benchmark fabric in each scene, seed 0."""
    return {(name, scene): solver.solve(FABRICS[name], Setup.nominal(scene)) for name, scene in CASES}
