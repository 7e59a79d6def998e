"""The server's side of its workers: what dies is replaced, what was begun is ended."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from services.jobs import processes
from services.jobs.processes import WorkerProcesses
from services.settings import Settings


class Process(SimpleNamespace):
    """Stands for a worker process."""

    def __init__(self, *, alive: bool) -> None:
        super().__init__(alive=alive, pid=1, exitcode=None)

    def is_alive(self) -> bool:
        return bool(self.alive)

    def terminate(self) -> None:
        self.alive = False

    def join(self, timeout_s: float) -> None:
        """It ends at once."""


NO_PROCESS = OSError(11, "Resource temporarily unavailable")


def workers(monkeypatch: pytest.MonkeyPatch, count: int, launch: Any) -> WorkerProcesses:
    monkeypatch.setattr(processes, "RESPAWN_AFTER_S", 0.01)
    monkeypatch.setattr(WorkerProcesses, "_launch", launch)
    return WorkerProcesses(Settings(workers=count))


def test_a_worker_that_cannot_be_replaced_at_once_is_replaced_later(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, replaced = Process(alive=True), Process(alive=True), threading.Event()
    made: Iterator[Process | OSError] = iter([first, NO_PROCESS, NO_PROCESS, second])

    def launch(self: WorkerProcesses) -> Process:
        found = next(made)
        if isinstance(found, OSError):
            raise found
        if found is second:
            replaced.set()
        return found

    watched = workers(monkeypatch, 1, launch)
    watched.start()
    first.alive = False
    assert replaced.wait(30)
    watched.close()
    assert not second.alive


def test_workers_that_were_begun_end_where_another_cannot_be(monkeypatch: pytest.MonkeyPatch) -> None:
    first = Process(alive=True)
    made = iter([first])

    def launch(self: WorkerProcesses) -> Process:
        for process in made:
            return process
        raise NO_PROCESS

    few = workers(monkeypatch, 2, launch)
    with pytest.raises(OSError, match="temporarily unavailable"):
        few.start()
    few.close()
    assert not first.alive
