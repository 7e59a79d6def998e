"""Worker processes: results, errors, death, and that none is left behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from pathlib import Path

import pytest

from metric.workers import run_in_processes
from simcore.errors import InputError, SimulationError
from tests.left_workers import check_workers_end


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


HOLDER = """
from metric.workers import run_in_processes
if __name__ == "__main__":
    list(run_in_processes(wait_long, {places!r}, 2))
"""


def test_workers_end_in_the_middle_of_an_item_when_who_started_them_is_killed(tmp_path: Path) -> None:
    check_workers_end(tmp_path, HOLDER, signal.SIGKILL)
