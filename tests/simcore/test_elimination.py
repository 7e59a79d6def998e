"""Orders of elimination that are kept in files: whole, better than PARDISO's own, and what the script makes."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from simcore import elimination, level, pardiso
from simcore.elimination import KEPT, elimination_order, equations_of
from simcore.grid import Grid
from simcore.mesh import GridMesh
from simcore.pardiso import Factorisation
from simcore.solver import Solver

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "elimination_order.py"
FILES = [(side, skew) for skew, sides in KEPT.items() for side in sides]


def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("elimination_order", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Counted(Factorisation):
    """One that lets PARDISO count the operations of a factorisation [millions]."""

    _COUNT = 18

    def _call(self, phase: int, *arrays: np.ndarray | None) -> int:
        self._settings[self._COUNT] = -1
        answer = super()._call(phase, *arrays)
        if phase == 11:
            self.operations = int(self._settings[self._COUNT])
        return answer


@pytest.mark.parametrize(("side", "skew"), FILES)
def test_each_equation_has_its_turn_once(side: int, skew: bool) -> None:
    order = elimination_order(side, side, skew)
    assert order is not None and order.dtype == np.int32
    assert np.array_equal(np.sort(order), np.arange(3 * side * side))
    assert np.array_equal(order.reshape(-1, 3) % 3, np.tile([0, 1, 2], (side * side, 1)))


@pytest.mark.parametrize(("side", "skew"), FILES)
def test_they_take_fewer_operations_than_pardisos_own(side: int, skew: bool) -> None:
    grid = Grid(side, side, 0.5 / (side - 1), 0.5 / (side - 1))
    pattern = grid.skew_pattern if skew else grid.pattern
    kept = Counted(pattern.indptr, pattern.indices, True, elimination_order(side, side, skew))
    own = Counted(pattern.indptr, pattern.indices, True)
    assert kept.operations < (0.75 if skew else 0.95) * own.operations


def test_other_grids_have_none() -> None:
    assert elimination_order(51, 61, False) is None
    assert elimination_order(26, 26, False) is None


def test_a_file_that_is_lost_is_no_other_order(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(elimination, "_FOLDER", tmp_path)
    with pytest.raises(FileNotFoundError):
        elimination_order(51, 51, False)


def test_solutions_are_those_of_another_order() -> None:
    pattern = Grid(9, 9, 0.01, 0.01).pattern
    made = script()
    vertices = np.array(made.postordered(*made.least_fill(made.neighbours(9))), dtype=np.int32)
    values = 0.02 * np.random.default_rng(0).standard_normal(len(pattern.indices))
    values[pattern.indptr[:-1]] = np.linspace(1.0, 3.0, 243)
    right = np.random.default_rng(1).standard_normal(243)
    solutions = []
    for order in (None, equations_of(vertices)):
        factorisation = Factorisation(pattern.indptr, pattern.indices, order=order)
        assert factorisation.factor(values) == 0
        solutions.append(factorisation.solve(right))
    assert solutions[0] == pytest.approx(solutions[1], rel=1e-12, abs=1e-12)


def test_the_order_fills_least_and_follows_the_tree() -> None:
    made = script()
    order, met = made.least_fill(made.neighbours(12))
    sets = made.neighbours(12)
    for vertex, left in zip(order, met, strict=True):
        fills = {other: made.fill(sets, other) for other in range(144) if other not in order[: order.index(vertex)]}
        assert (fills[vertex], vertex) == min((fill, other) for other, fill in fills.items())
        assert left == made.members(sets[vertex])
        for other in left:
            sets[other] = (sets[other] | sets[vertex]) & ~(1 << other) & ~(1 << vertex)
        sets[vertex] = 0
    place = {vertex: number for number, vertex in enumerate(made.postordered(order, met))}
    parents = [min((place[other] for other in left), default=144) for left in met]
    for vertex, left in zip(order, met, strict=True):
        assert all(place[other] > place[vertex] for other in left)
    # postorder: the vertices of a subtree stand together, the root last
    sizes = [1] * 145
    for vertex, parent in sorted(zip(order, parents, strict=True), key=lambda pair: place[pair[0]]):
        sizes[parent] += sizes[place[vertex]] if parent < 144 else 0
        first = place[vertex] - sizes[place[vertex]] + 1
        below = [place[other] for other, up in zip(order, parents, strict=True) if up == place[vertex]]
        assert all(first <= child < place[vertex] for child in below)


@pytest.mark.slow
@pytest.mark.parametrize(("side", "skew"), [(51, False), (26, True)])
def test_the_files_are_what_the_script_makes(side: int, skew: bool) -> None:
    made = script()
    vertices = made.postordered(*made.least_fill(made.neighbours(side, skew)))
    kept = elimination_order(side, side, skew)
    assert kept is not None and np.array_equal(kept[::3] // 3, vertices)


def test_the_solver_eliminates_by_them(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[object] = []

    class Spy(pardiso.Factorisation):
        def __init__(self, indptr: np.ndarray, indices: np.ndarray, single: bool, order: np.ndarray | None) -> None:
            taken.append(None if order is None else len(order))
            super().__init__(indptr, indices, single, order)

    monkeypatch.setattr(level, "Factorisation", Spy)
    Solver(GridMesh(0.01))
    assert taken == [None, None, 7803, 7803]
