"""Worker processes: results, errors, death, and that none is left behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from metric.workers import run_in_processes
from simcore.errors import InputError, SimulationError


def square(number: int) -> int:
    return number * number


def fail(number: int) -> int:
    if number == 2:
        raise InputError("two cannot be used", code="two")
    return number


def crash(number: int) -> int:
    if number == 1:
        raise ZeroDivisionError("a mistake")
    return number


def die(number: int) -> int:
    os._exit(9)


def dawdle(number: int) -> int:
    time.sleep(0 if number == 0 else 3600)
    return number


@pytest.fixture(autouse=True)
def nobody_left() -> object:
    yield
    assert multiprocessing.active_children() == []


def test_every_item_once() -> None:
    assert sorted(run_in_processes(square, range(7), 2)) == [n * n for n in range(7)]


def test_errors_keep_their_code() -> None:
    with pytest.raises(InputError, match="two") as caught:
        list(run_in_processes(fail, [0, 1, 2], 1))
    assert caught.value.code == "two"


def test_a_mistake_shows_where() -> None:
    with pytest.raises(RuntimeError, match="ZeroDivisionError: a mistake"):
        list(run_in_processes(crash, [1], 1))


def test_a_dead_worker_is_said() -> None:
    with pytest.raises(SimulationError, match="exit code 9") as caught:
        list(run_in_processes(die, [1], 1))
    assert caught.value.code == "worker_died"


def test_workers_stop_at_once_when_nobody_wants_more() -> None:
    results = run_in_processes(dawdle, [0, 1, 2], 2)
    assert next(results) == 0
    results.close()  # `nobody_left` and the test's time-out say whether they did


def wait_long(place: str) -> str:
    Path(place).touch()
    time.sleep(300.0)
    return place


HOLDER = """
import sys
sys.path.insert(0, {root!r})
from metric.workers import run_in_processes
from tests.metric.test_workers import wait_long
if __name__ == "__main__":
    list(run_in_processes(wait_long, {places!r}, 2))
"""


def test_workers_end_in_the_middle_of_an_item_when_who_started_them_is_killed(tmp_path: Path) -> None:
    script, at_work = tmp_path / "holder.py", [tmp_path / "one", tmp_path / "two"]
    script.write_text(HOLDER.format(root=str(Path(__file__).parents[2]), places=[str(place) for place in at_work]))
    holder = subprocess.Popen([sys.executable, str(script)], stderr=subprocess.DEVNULL)
    wait_until(lambda: all(place.exists() for place in at_work))
    workers = spawned_by(holder.pid)
    assert len(workers) == 2
    holder.send_signal(signal.SIGKILL)
    holder.wait(60)
    wait_until(lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers))


def spawned_by(parent: int) -> list[int]:
    """Worker processes of a process; its resource tracker is none."""
    text = Path(f"/proc/{parent}/task/{parent}/children").read_text()
    return [int(pid) for pid in text.split() if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def wait_until(done: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not done():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.1)
