"""Many cloths at once: the layout a GPU gets, run on the CPU and judged like single drapes."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from simcore.batch.alone import Alone
from simcore.batch.cholesky import BlockCholesky, invert_factor
from simcore.batch.device import Device
from simcore.batch.newton import NEVER, BatchNewton
from simcore.batch.placement import _positive
from simcore.batch.request import Request
from simcore.batch.solver import BatchSolver
from simcore.drape import Drape, DrapeStatus
from simcore.errors import DrapemeterError, InputError
from simcore.mechanics import NO_JITTER, Mechanics, UniformCurvature
from simcore.mesh import GridMesh
from simcore.newton import FACTORISATIONS, NewtonOptions
from simcore.placement import STEPS
from simcore.scenes import GRAVITY_M_S2, Scene, Setup
from simcore.solver import Solver

from .judge import cloth_of, held_places, lowest_stiffness, positions
from .rigs import FABRICS, Rig, assembled, crumpled, strip

HANGING, STRETCH = Setup.nominal(Scene.HANGING), Setup.nominal(Scene.STRETCH)
TILTED = (0.0, -GRAVITY_M_S2 * math.cos(0.03), -GRAVITY_M_S2 * math.sin(0.03))
MECHANICS = {
    "nothing": Mechanics(),
    "stiffening": Mechanics(stiffening_strain=0.01),
    "curved": Mechanics(rest_curvature=(UniformCurvature(8.0, -3.0),)),
    "off grain": Mechanics(off_grain_rad=0.1),
    "hem and draft": Mechanics(hem_kg_m=0.02, air_pressure_pa=0.2),
    "tilt and adhesion": Mechanics(gravity=TILTED, adhesion_pa=1.0),
}
REQUESTS = [
    Request(FABRICS["stiff" if n % 2 else "medium"], setup, seed=3, mechanics=mechanics)
    for setup in (HANGING, STRETCH)
    for n, mechanics in enumerate(MECHANICS.values())
]
MESH = GridMesh(0.05)


@pytest.fixture(scope="module")
def batch() -> BatchSolver:
    return BatchSolver(MESH, "cpu", most=len(REQUESTS))


@pytest.fixture(scope="module")
def drapes(batch: BatchSolver) -> list[Drape]:
    return batch.solve(REQUESTS)


def test_every_cloth_of_a_batch_is_at_rest_by_the_reference(drapes: list[Drape]) -> None:
    for request, drape in zip(REQUESTS, drapes, strict=True):
        assert drape.status is DrapeStatus.STILL, drape.reason
        cloth, x = cloth_of(drape, request.fabric, request.setup, request.mechanics, seed=3), positions(drape)
        assert cloth.residual(x) < 1e-3
        assert cloth.energy(x) == pytest.approx(drape.energy, rel=1e-9)
        assert x[..., 2].min() >= 0.0
        held, places = held_places(drape, request.setup, request.jitter, 3)
        assert x[held] == pytest.approx(places[held], abs=1e-12)


def test_the_batch_itself_brings_them_to_rest(batch: BatchSolver, drapes: list[Drape]) -> None:
    # a batch whose drapes all came from the single solver would pass every other test here
    assert batch.put_up_again <= 2
    assert {drape.status for drape in drapes} == {DrapeStatus.STILL}


def test_steps_are_those_of_putting_up_too(batch: BatchSolver, drapes: list[Drape]) -> None:
    single = Solver(MESH)
    for request, drape in list(zip(REQUESTS, drapes, strict=True))[::5]:
        own = single.solve(request.fabric, request.setup, seed=3, mechanics=request.mechanics)
        assert own.iterations > STEPS < drape.iterations < STEPS + 3 * (own.iterations - STEPS)


def test_steps_and_seconds_of_a_first_attempt_count(monkeypatch: pytest.MonkeyPatch) -> None:
    batch, request = BatchSolver(MESH, "cpu", most=1), REQUESTS[0]
    own = Solver(MESH).solve(request.fabric, request.setup, seed=3)
    failed = replace(own, status=DrapeStatus.NOT_STILL, iterations=1000, seconds=2000.0)
    monkeypatch.setattr(batch, "_batch", lambda requests: [failed for _ in requests])
    again = batch.solve([request])[0]
    assert again.ok and again.iterations == own.iterations + 1000 and again.seconds > 2000.0


class Shifted:
    """In place of a level: one unknown a cloth, whose Hessian is positive from some shift on."""

    def __init__(self, needed: list[float], weights: list[float], hu: float = 0.02) -> None:
        self.needed, self.weights = torch.tensor(needed), torch.tensor(weights)
        self.grid, self.free = SimpleNamespace(hu=hu), torch.ones((len(needed), 1, 1, 1))
        self.shifts: list[list[float]] = []

    def factor(self, which: torch.Tensor, x: torch.Tensor, blend: torch.Tensor, shift: torch.Tensor) -> Any:
        """Factors that are the shifts, and which are positive."""
        one = shift.reshape(len(which))
        self.shifts.append(one.tolist())
        factors = SimpleNamespace(shift=one.clone())
        factors.put = lambda rows, others: factors.shift.__setitem__(rows, others.shift)
        return factors, (one >= self.needed[which]) & torch.isfinite(x).all(dim=(1, 2, 3))

    def solve(self, factors: Any, right: torch.Tensor) -> torch.Tensor:
        """Nothing changes."""
        return right


def test_a_cloth_that_is_not_finite_does_not_keep_others_from_their_shifts() -> None:
    level: Any = Shifted([0.0, 50.0, 0.0, 3.0], [1.0] * 4)
    x = torch.zeros((4, 1, 1, 3), dtype=torch.float64)
    x[2] = math.nan
    factors: Any = _positive(level, torch.arange(4), x, torch.ones((4, 1, 1), dtype=torch.float64))
    assert factors.shift.tolist() == [1.0, 64.0, 1.0, 4.0]
    assert [len(shifts) for shifts in level.shifts] == [4, 2, 1, 1]


def test_a_hessian_that_no_shift_makes_positive_ends() -> None:
    level: Any = Shifted([math.inf], [1.0])
    _positive(level, torch.arange(1), torch.zeros((1, 1, 1, 3)), torch.ones((1, 1, 1), dtype=torch.float64))
    assert len(level.shifts) == FACTORISATIONS + 1


def test_shifts_at_a_saddle_are_counted_as_those_of_a_single_drape() -> None:
    """In weights of a vertex over the cell, which is what damping is counted in."""
    level: Any = Shifted([0.0, 1e-3, 1e4], [0.02, 0.04, 0.02])
    x = torch.zeros((3, 1, 1, 3), dtype=torch.float64)
    BatchNewton(level, NewtonOptions())._lowest_modes(torch.arange(3), x)
    assert level.shifts[0] == pytest.approx([1e-4, 2e-4, 1e-4])
    assert [shifts[0] for shifts in level.shifts[1:3]] == pytest.approx([8e-4, 32e-4])
    assert 1e4 <= level.shifts[-1][0] < 4e4


def test_certified_by_an_eigenvalue_solver(drapes: list[Drape]) -> None:
    for request, drape in list(zip(REQUESTS, drapes, strict=True))[::4]:
        cloth = cloth_of(drape, request.fabric, request.setup, request.mechanics, seed=3)
        assert lowest_stiffness(cloth, positions(drape)) > -1e-6


def test_the_single_solver_takes_them_as_they_are(drapes: list[Drape]) -> None:
    single = Solver(MESH)
    for request, drape in zip(REQUESTS, drapes, strict=True):
        own = single.solve(request.fabric, request.setup, seed=3, mechanics=request.mechanics, start=drape)
        assert own.ok and own.iterations <= 3
        assert np.abs(own.vertices - drape.vertices).max() < 1e-4


def test_where_there_is_one_equilibrium_both_solvers_find_it(batch: BatchSolver) -> None:
    found = batch.solve([Request(FABRICS["vstiff"], HANGING, jitter=NO_JITTER)] * 2)
    own = Solver(MESH).solve(FABRICS["vstiff"], HANGING, jitter=NO_JITTER)
    for drape in found:
        assert np.abs(own.vertices - drape.vertices).max() < 1e-4
        assert own.energy == pytest.approx(drape.energy, rel=1e-7)


def test_friction_holds_in_a_batch_too(batch: BatchSolver) -> None:
    rubbing = Request(FABRICS["medium"], STRETCH, seed=1, mechanics=Mechanics(friction=0.6))
    sliding, held = batch.solve([Request(FABRICS["medium"], STRETCH, seed=1), rubbing])
    assert sliding.ok and held.ok
    assert np.abs(sliding.vertices - held.vertices).max() > 1e-5
    own = Solver(MESH).solve(rubbing.fabric, rubbing.setup, seed=1, mechanics=rubbing.mechanics)
    assert own.vertices.tobytes() == held.vertices.tobytes()


def test_the_same_batch_gives_the_same_bits(batch: BatchSolver, drapes: list[Drape]) -> None:
    again = BatchSolver(MESH, "cpu", most=len(REQUESTS)).solve(REQUESTS)
    assert all(a.vertices.tobytes() == b.vertices.tobytes() for a, b in zip(drapes, again, strict=True))


def test_more_requests_than_fit_at_once() -> None:
    few = BatchSolver(MESH, "cpu", most=2).solve(REQUESTS[6:9])
    assert [drape.ok for drape in few] == [True, True, True]


def test_a_saddle_is_left() -> None:
    # with nothing random the first stationary point is the symmetric one, which soft cloth does not keep
    drape = BatchSolver(MESH, "cpu", most=2).solve([Request(FABRICS["medium"], HANGING, jitter=NO_JITTER)] * 2)[0]
    assert drape.ok and drape.stable


def test_block_cholesky_solves_what_the_level_assembles() -> None:
    for rows in (0.10, 0.12):  # an even and an odd number of rows of vertices
        level = strip(0.08, rows, 0.02)
        grid = level.grid
        held = np.zeros((grid.rows, grid.columns), dtype=bool)
        held[0] = True
        Rig.of(level, FABRICS["medium"], held, panel=True)
        x = crumpled(grid, 1)
        matrix = assembled(level, x, 0.0)
        stencil = level._model._stencil.copy()
        shifted = stencil.copy()
        shifted[:, grid.rows // 2, 1, 0, [0, 1, 2], [0, 1, 2]] -= 10.0 * abs(stencil).max()  # no longer positive
        device = Device("cpu")
        factors, good = BlockCholesky(grid, device).factor(torch.from_numpy(np.concatenate([stencil, shifted])))
        assert good.tolist() == [True, False]
        right = np.random.default_rng(0).standard_normal((2, x.size))
        solved = factors.solve(torch.from_numpy(right))[0].numpy()
        assert matrix @ solved == pytest.approx(right[0], abs=1e-8)


def test_what_cannot_be_had_is_said_in_one_line() -> None:
    if not torch.cuda.is_available():
        with pytest.raises(DrapemeterError, match=r"no CUDA device.*or use arch cpu") as caught:
            BatchSolver(MESH, "cuda")
        assert caught.value.code == "cuda_missing"
    with pytest.raises(InputError, match="at least one sample, not 0") as refused:
        BatchSolver(MESH, "cpu", most=0)
    assert refused.value.code == "batch_size"
    with pytest.raises(InputError, match="the mesh is for a sample"):
        BatchSolver(MESH, "cpu", most=1).solve(
            [Request(FABRICS["stiff"], Setup.nominal(Scene.HANGING, sample_size_m=(0.4, 0.4)))]
        )


def test_factors_are_inverted_by_halves_too() -> None:
    generator = torch.Generator().manual_seed(1)
    half = torch.randn((3, 33, 33), generator=generator, dtype=torch.float64)
    blocks = half @ half.mT + torch.eye(33)
    blocks[1, 20, 20] = -1.0
    inverse, good = invert_factor(blocks.clone(), leaf=6)
    assert good.tolist() == [True, False, True]
    for n in (0, 2):
        expected = np.linalg.inv(np.linalg.cholesky(blocks[n].numpy()))
        assert inverse[n].numpy() == pytest.approx(expected, abs=1e-9)


def test_processes_of_their_own_put_up_the_same_drapes() -> None:
    own = Solver(MESH)
    wanted = REQUESTS[:3]
    drapes = Alone(MESH, processes=2).solve(wanted, None)
    for request, drape in zip(wanted, drapes, strict=True):
        alike = own.solve(request.fabric, request.setup, seed=3, mechanics=request.mechanics)
        assert drape.vertices.tobytes() == alike.vertices.tobytes() and drape.status is alike.status
    with pytest.raises(DrapemeterError, match="the mesh is for a sample"):
        Alone(MESH, processes=1).solve(
            [Request(FABRICS["stiff"], Setup.nominal(Scene.HANGING, sample_size_m=(0.4, 0.4)))], None
        )


def test_others_take_the_places_of_those_at_rest(drapes: list[Drape]) -> None:
    # a window of five over twelve: all are at rest by the reference, whoever they were worked on with
    few = BatchSolver(MESH, "cpu", most=5)
    for request, drape in zip(REQUESTS, few.solve(REQUESTS), strict=True):
        cloth = cloth_of(drape, request.fabric, request.setup, request.mechanics, seed=3)
        assert drape.status is DrapeStatus.STILL and cloth.residual(positions(drape)) < 1e-3
    assert few.put_up_again <= 2


ON_A_GPU = """
from simcore import lang
lang.start("cuda")
import numpy as np
from simcore.batch.alone import Alone
from simcore.batch.solver import BatchSolver
from tests.simcore.test_batch import FABRICS, HANGING, MESH, NO_JITTER, REQUESTS, Request, cloth_of, positions
batch = BatchSolver(MESH, "cuda", most=len(REQUESTS))
drapes = batch.solve(REQUESTS)
assert all(drape.ok for drape in drapes), [drape.reason for drape in drapes]
assert batch.put_up_again <= 2, batch.put_up_again
for request, drape in zip(REQUESTS, drapes, strict=True):
    cloth, x = cloth_of(drape, request.fabric, request.setup, request.mechanics, seed=3), positions(drape)
    assert cloth.residual(x) < 1e-3 and abs(cloth.energy(x) / drape.energy - 1.0) < 1e-9
again = batch.solve(REQUESTS)
assert all(a.vertices.tobytes() == b.vertices.tobytes() for a, b in zip(drapes, again, strict=True))
stiff = [Request(FABRICS["vstiff"], HANGING, jitter=NO_JITTER)] * 2
own = Alone(MESH, processes=1).solve(stiff[:1], None)[0]
assert all(np.abs(own.vertices - drape.vertices).max() < 1e-4 for drape in batch.solve(stiff))
"""


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_gpu_agrees_with_the_reference_and_with_the_cpu(repository: object) -> None:
    # Taichi has one runtime a process
    subprocess.run([sys.executable, "-c", ON_A_GPU], check=True, cwd=str(repository))


def test_what_damping_cures_refuses_no_blend() -> None:
    """As in the solver of single drapes: at blend 0 a refused matrix says nothing of the exact Hessian's share."""
    newton = BatchNewton(Shifted([0.0, 0.0], [1.0, 1.0]), NewtonOptions())  # type: ignore[arg-type]
    state: Any = SimpleNamespace(
        blend=torch.tensor([0.0, 0.5]), damping=torch.zeros(2), refused=torch.full((2,), NEVER, dtype=torch.float32)
    )
    newton._ease(state, torch.tensor([True, True]))
    assert state.refused.tolist() == [NEVER, 0.5]
    assert state.damping.tolist() == pytest.approx([1e-3, 0.0]) and state.blend.tolist() == [0.0, 0.25]
