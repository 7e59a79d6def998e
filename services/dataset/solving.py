"""How the simulations of a shard are solved: one after the other, or all at once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

from services.dataset.solver_kind import SolverKind
from simcore.batch.request import Request
from simcore.mechanics import Mechanics
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

if TYPE_CHECKING:
    from simcore.batch.solver import BatchSolver
    from simcore.drape import Drape


class DrapeSolver(Protocol):
    """What a simulation of a sweep needs."""

    def solve(
        self,
        fabric: FabricParameters,
        setup: Setup,
        *,
        seed: int,
        mechanics: Mechanics,
        time_limit_s: float,
    ) -> Drape:
        """See :meth:`simcore.solver.Solver.solve`."""
        ...


class ShardSolver:
    """Solves the simulations of a shard together and hands their drapes out one by one.

    Args:
        mesh: of the sweep.
        kind: ``batch`` or ``cuda``.
        most: simulations of a shard.
    """

    def __init__(self, mesh: GridMesh, kind: SolverKind, most: int) -> None:
        from simcore.batch.solver import BatchSolver  # in the worker alone, with PyTorch

        self._batch: BatchSolver = BatchSolver(mesh, "cuda" if kind is SolverKind.CUDA else "cpu", most)
        self._drapes: dict[int, Drape] = {}

    def ahead(self, requests: Mapping[int, Request], time_limit_s: float) -> None:
        """Solve these now; each is asked for by its seed afterwards."""
        drapes = self._batch.solve(list(requests.values()), time_limit_s=time_limit_s)
        self._drapes = dict(zip(requests, drapes, strict=True))

    def solve(
        self,
        fabric: FabricParameters,
        setup: Setup,
        *,
        seed: int,
        mechanics: Mechanics,
        time_limit_s: float,
    ) -> Drape:
        """The drape solved ahead, else a batch of this one alone."""
        ready = self._drapes.pop(seed, None)
        if ready is not None:
            return ready
        return self._batch.solve([Request(fabric, setup, seed, mechanics=mechanics)], time_limit_s=time_limit_s)[0]
