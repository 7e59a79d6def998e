"""Work that a cluster never begins is given up, work that takes long is not. Ray is not started."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from services.dataset import spread as module
from services.dataset.spread import DEATHS, spread
from simcore.errors import StoreError

ROUNDS = 5
"""Looks after which a stand-in's work is done, where any is."""


class StandInRay(SimpleNamespace):
    """A test's Ray: tasks are known by their names.

    Args:
        cpus: that the cluster declares, look by look; the last one stays.
        starts: whether its workers start.
    """

    def __init__(self, cpus: Sequence[float], *, starts: bool) -> None:
        errors = SimpleNamespace(**{name: type(name, (Exception,), {}) for name in ("RayTaskError", *DEATHS)})
        super().__init__(exceptions=errors, cpus=list(cpus), starts=starts, looks=0, called_off=[])

    def remote(self, function: Any) -> SimpleNamespace:
        task = SimpleNamespace(remote=lambda *parcel: (function, parcel))
        task.options = lambda **asked: task
        return task

    def wait(self, tasks: list[Any], *, timeout: float, num_returns: int = 1) -> tuple[list[Any], list[Any]]:
        if timeout:
            self.looks += 1
        done = self.starts and (not timeout or self.looks > ROUNDS)
        return (tasks[:1], tasks[1:]) if done else ([], tasks)

    def get(self, tasks: list[Any]) -> list[Any]:
        return [function(*parcel) for function, parcel in tasks]

    def cluster_resources(self) -> dict[str, float]:
        return {"CPU": self.cpus.pop(0) if len(self.cpus) > 1 else self.cpus[0]}

    def cancel(self, task: Any) -> None:
        self.called_off.append(task)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten minutes between two looks."""
    seconds = iter(range(0, 10**6, 600))
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: float(next(seconds))))


@pytest.mark.parametrize(
    ("cpus", "starts", "told", "looks"),
    [
        ([0.0], True, "has had no worker for 900 s: start some", 2),
        ([2.0], False, "has had CPUs for 900 s and could start no process on them: .*logs on its machines say why", 3),
        ([0.0, 2.0], False, "has had CPUs for 900 s", 4),
        ([2.0, 0.0], False, "has had no worker for 900 s", 2),
    ],
)
def test_work_that_nobody_begins_is_given_up(
    cpus: list[float], starts: bool, told: str, looks: int, clock: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    ray = StandInRay(cpus, starts=starts)
    monkeypatch.setitem(sys.modules, "ray", ray)
    with pytest.raises(StoreError, match=told) as caught:
        list(spread(abs, [-1, -2], 1))
    assert caught.value.code == "workers_missing"
    assert ray.looks == looks and len(ray.called_off) >= 2  # nothing is left behind


def test_work_that_takes_long_is_waited_for(clock: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour, on a cluster whose workers start."""
    ray = StandInRay([2.0], starts=True)
    monkeypatch.setitem(sys.modules, "ray", ray)
    assert sorted(spread(abs, [-1, -2], 1)) == [1, 2]
    assert ray.looks > ROUNDS
