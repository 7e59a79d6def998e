"""Work on fabrics, in this process or in others."""

from __future__ import annotations

import os
import pickle
import signal
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info, threadpool_limits  # type: ignore[import-untyped]

from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Simulator, solver_of
from diagnosis.workers import Workers
from simcore.errors import SimulationError
from simcore.mesh import GridMesh
from tests.left_workers import check_workers_end


def where(item: int) -> tuple[int, int]:
    return item, os.getpid()


def test_one_worker_is_the_calling_process() -> None:
    done: list[float] = []
    with Workers(1) as workers:
        assert workers.map(where, [3, 1, 2], done.append) == [(k, os.getpid()) for k in (3, 1, 2)]
    assert done == [1.0, 1.0, 1.0]


def test_two_workers_keep_the_order_and_end_with_their_work() -> None:
    done: list[float] = []
    with Workers(2) as workers:
        made = workers.map(where, [3, 1, 2], done.append) + workers.map(where, [5, 4])
    assert [item for item, _ in made] == [3, 1, 2, 5, 4]
    processes = {process for _, process in made}
    assert os.getpid() not in processes
    assert len(processes) <= 2
    assert len(done) == 3
    assert not any(Path(f"/proc/{process}").exists() for process in processes)


def threads(item: int) -> int:
    """Most threads that a numerical library of this process may use now."""
    import numpy as np

    np.eye(2) @ np.eye(2)
    return max(int(pool["num_threads"]) for pool in threadpool_info())


@pytest.mark.parametrize("count", [1, 2])
def test_each_item_is_worked_on_in_one_numerical_thread(count: int) -> None:
    with threadpool_limits(2), Workers(count) as workers:
        assert workers.map(threads, [1, 2]) == [1, 1]
        assert threads(0) > 1  # the caller has its own again


def die(item: int) -> int:
    os._exit(item)


def test_a_worker_that_dies_is_one_clear_error() -> None:
    with Workers(2) as workers, pytest.raises(SimulationError, match="a worker process died"):
        workers.map(die, [3, 4])


def test_a_simulator_travels_without_its_solvers(tmp_path: Path) -> None:
    simulator = Simulator(DrapeCache(tmp_path))
    mesh = GridMesh(0.05)
    assert solver_of(mesh) is solver_of(GridMesh(0.05))
    arrived = pickle.loads(pickle.dumps(simulator))
    assert arrived == simulator


HOLDER = """
from diagnosis.workers import Workers
if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as the command does; Ctrl-C is ignored in a background
    with Workers(2) as workers:
        workers.map(wait_long, {places!r})
"""


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_workers_do_not_outlive_who_started_them(tmp_path: Path, how: signal.Signals) -> None:
    check_workers_end(tmp_path, HOLDER, how)
