"""Too little memory where the solver is called from Python."""

from __future__ import annotations

import numpy as np
import pytest

from simcore import solver as solver_module
from simcore.errors import OutOfMemoryError
from simcore.mesh import GridMesh
from simcore.newton import Newton
from simcore.scenes import Scene, Setup
from simcore.solver import Solver

from .rigs import FABRICS


def short(said: str) -> object:
    def short_of_memory(*_: object, **__: object) -> None:
        raise MemoryError(said)

    return short_of_memory


@pytest.mark.parametrize(("said", "told"), [("Unable to allocate 2.0 GiB", "2.0 GiB"), ("", "no more was to be had")])
def test_a_drape_without_memory_says_so_and_the_solver_goes_on(
    solver: Solver, monkeypatch: pytest.MonkeyPatch, said: str, told: str
) -> None:
    setup = Setup.nominal(Scene.HANGING)
    with monkeypatch.context() as patched:
        patched.setattr(Newton, "minimise", short(said))
        with pytest.raises(OutOfMemoryError, match=f"676 vertices.*{told}.*coarser cells") as caught:
            solver.solve(FABRICS["stiff"], setup)
    assert caught.value.code == "out_of_memory"
    again, first = solver.solve(FABRICS["stiff"], setup), Solver(solver.mesh).solve(FABRICS["stiff"], setup)
    assert again.ok and np.array_equal(again.vertices, first.vertices)


def test_a_solver_without_memory_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver_module, "Level", short("Unable to allocate 9.0 GiB"))
    with pytest.raises(OutOfMemoryError, match=r"2601 vertices.*9\.0 GiB"):
        Solver(GridMesh(0.01))
