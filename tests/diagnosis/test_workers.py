"""Work on fabrics, in this process or in others."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from threadpoolctl import threadpool_info, threadpool_limits  # type: ignore[import-untyped]

from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Simulator, solver_of
from diagnosis.workers import Workers
from simcore.errors import SimulationError
from simcore.mesh import GridMesh


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


def wait_long(place: str) -> str:
    Path(place).touch()
    time.sleep(300.0)
    return place


HOLDER = """
import signal, sys
sys.path.insert(0, {root!r})
from diagnosis.workers import Workers
from tests.diagnosis.test_workers import wait_long
if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as the command does; Ctrl-C is ignored in a background
    with Workers(2) as workers:
        workers.map(wait_long, {places!r})
"""


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_workers_do_not_outlive_who_started_them(tmp_path: Path, how: signal.Signals) -> None:
    script = tmp_path / "holder.py"
    at_work = [tmp_path / "one", tmp_path / "two"]
    script.write_text(HOLDER.format(root=str(Path(__file__).parents[2]), places=[str(place) for place in at_work]))
    holder = subprocess.Popen([sys.executable, str(script)], stderr=subprocess.DEVNULL)
    wait_for(lambda: True if all(place.exists() for place in at_work) else None)
    children = spawned_by(holder.pid)
    assert len(children) == 2
    holder.send_signal(how)
    holder.wait(60)
    wait_for(lambda: True if not any(Path(f"/proc/{child}").exists() for child in children) else None)


def spawned_by(parent: int) -> list[int]:
    """Worker processes of a process; its resource tracker is none."""
    text = Path(f"/proc/{parent}/task/{parent}/children").read_text()
    return [int(pid) for pid in text.split() if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def wait_for(look: Callable[[], Any]) -> Any:
    """What ``look`` gives once it gives something."""
    end = time.monotonic() + 60.0
    while (seen := look()) is None:
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.1)
    return seen
