"""Samples that a batch leaves to the solver of single drapes.

Taichi has one runtime a process: beside one on a GPU they are put up in processes of their own, which start as
``python -m simcore.batch.alone``, read a pickle from standard input and write one to standard output.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from simcore.batch.request import Request
from simcore.drape import Drape
from simcore.errors import DrapemeterError
from simcore.mesh import GridMesh
from simcore.solver import Solver

PROCESSES = 4
"""At most, for one batch."""


class Alone:
    """Puts samples up one by one.

    Args:
        mesh: of every sample.
        processes: how many to do it in; 0 for this one, whose Taichi must run on the CPU.
    """

    def __init__(self, mesh: GridMesh, processes: int) -> None:
        self._mesh = mesh
        self._processes = processes
        self._solver: Solver | None = None

    def solve(self, requests: Sequence[Request], time_limit_s: float | None) -> list[Drape]:
        """Drapes in the order of the requests.

        Args:
            requests: any number.
            time_limit_s: CPU seconds for each.

        Raises:
            DrapemeterError: as :meth:`simcore.solver.Solver.solve` raises.
            RuntimeError: a process ended without an answer.
        """
        if not requests:
            return []
        if self._processes == 0:
            if self._solver is None:
                self._solver = Solver(self._mesh)
            return [_put_up(self._solver, request, time_limit_s) for request in requests]
        shares = [requests[k :: self._processes] for k in range(min(self._processes, len(requests)))]
        with ThreadPoolExecutor(len(shares)) as pool:
            answers = list(pool.map(lambda share: _elsewhere(self._mesh, share, time_limit_s), shares))
        return [answers[n % len(shares)][n // len(shares)] for n in range(len(requests))]


def _elsewhere(mesh: GridMesh, requests: Sequence[Request], time_limit_s: float | None) -> list[Drape]:
    """Drapes of one process, which tells on standard error what it fails of."""
    done = subprocess.run(
        [sys.executable, "-P", "-m", "simcore.batch.alone"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        input=pickle.dumps((mesh, requests, time_limit_s)),
        stdout=subprocess.PIPE,
        check=False,
    )
    if done.returncode != 0:
        raise RuntimeError(f"a process that puts samples up one by one ended with status {done.returncode}")
    answer = pickle.loads(done.stdout)
    if isinstance(answer, DrapemeterError):
        raise answer
    drapes: list[Drape] = answer
    return drapes


def _put_up(solver: Solver, request: Request, time_limit_s: float | None) -> Drape:
    return solver.solve(
        request.fabric, request.setup, seed=request.seed, jitter=request.jitter, mechanics=request.mechanics,
        time_limit_s=time_limit_s,
    )  # fmt: skip


def main() -> None:
    """The process: one answer, drapes or what was raised."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever greets on standard output does not belong to the answer
    mesh, requests, time_limit_s = pickle.load(sys.stdin.buffer)
    try:
        answer: object = Alone(mesh, 0).solve(requests, time_limit_s)
    except DrapemeterError as error:
        answer = error
    with output:
        output.write(pickle.dumps(answer))


if __name__ == "__main__":
    main()
