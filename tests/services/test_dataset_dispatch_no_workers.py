"""The driver's loop on a cluster that has no CPU free, or on which workers die or lack memory. Ray is not started."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from renderer.store import RowStatus
from services.dataset import dispatch
from services.dataset.dispatch import MAX_SHORT, MAX_STILLBORN, Dispatcher, DispatchOptions
from simcore.errors import OutOfMemoryError, StoreError
from tests.services.dataset_helpers import small_sweep
from tests.services.dataset_stub_workers import ObedientWorker


class RayError(Exception):
    """Stands for Ray's."""


class StandInRay(SimpleNamespace):
    """A test's Ray: actors are made, some come up, and none is ever heard of again but by its death.

    Args:
        free: whether a CPU is free for workers at all.
        born: whether they live until they are given a shard.
    """

    def __init__(self, *, free: bool, born: bool) -> None:
        kinds = {name: type(name, (RayError,), {}) for name in ("RayTaskError", "OutOfMemoryError")}
        errors = SimpleNamespace(RayError=RayError, **kinds)
        super().__init__(exceptions=errors, free=free, born=born, made=0, killed=0)

    def remote(self, worker_class: type[Any]) -> SimpleNamespace:
        return SimpleNamespace(options=lambda **asked: SimpleNamespace(remote=self.make))

    def make(self, *given: object) -> SimpleNamespace:
        self.made += 1
        run = SimpleNamespace(remote=lambda task: _stream("word"))
        run.options = lambda **asked: run
        return SimpleNamespace(__ray_ready__=SimpleNamespace(remote=lambda: f"ready {self.made}"), run=run)

    def wait(self, watched: Sequence[Any], **_: Any) -> tuple[list[Any], list[Any]]:
        return (list(watched), []) if self.free else ([], list(watched))

    def get(self, event: Any) -> None:
        if event == "word" or not self.born:
            raise RayError("the actor died")

    def kill(self, actor: object) -> None:
        self.killed += 1


def _stream(word: str) -> Iterator[str]:
    while True:
        yield word


@pytest.mark.parametrize(
    ("free", "born", "code", "told", "made", "killed"),
    [
        (
            False,
            True,
            "workers_missing",
            "no worker has come up in 0 s: the cluster has no free CPU, or cannot start",
            1,
            1,
        ),
        (True, False, "workers_die", "workers die before they start: the actor died", MAX_STILLBORN + 1, 0),
        (True, True, "workers_die", r"shard 2 took 13 workers: the worker died \(RayError\)", 13, 13),
    ],
)
def test_a_sweep_without_workers_ends_with_one_line(
    free: bool,
    born: bool,
    code: str,
    told: str,
    made: int,
    killed: int,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    ray = StandInRay(free=free, born=born)
    monkeypatch.setitem(sys.modules, "ray", ray)
    monkeypatch.setattr(dispatch, "POLL_S", 0.0)
    configuration, fabrics = small_sweep()
    options = DispatchOptions(workers=1, start_allowance_s=900.0 if free else 0.0)
    driver = Dispatcher(str(tmp_path), configuration, fabrics, options, worker_class=ObedientWorker)
    with pytest.raises(StoreError, match=told) as caught:
        driver.run([2])
    assert caught.value.code == code
    assert (ray.made, ray.killed) == (made, killed)  # none is left behind
    assert not list(tmp_path.iterdir())


def test_workers_that_die_before_they_start_are_counted_one_after_the_other(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In a long sweep some do, a machine's worth at once."""
    ray = StandInRay(free=True, born=False)
    monkeypatch.setitem(sys.modules, "ray", ray)
    many = 2 * MAX_STILLBORN
    driver = Dispatcher(str(tmp_path), *small_sweep(), DispatchOptions(workers=many), worker_class=ObedientWorker)
    for lost in range(3 * many):
        ray.born = lost % many == 0
        driver._starting["ready"] = dispatch._Slot(None)
        driver._came_up("ready")
    with pytest.raises(StoreError, match="workers die before they start"):
        for _ in range(3):
            driver._starting["ready"] = dispatch._Slot(None)
            driver._came_up("ready")


@pytest.mark.parametrize("said_by", ["the worker", "Ray"])
@pytest.mark.parametrize("short", [MAX_SHORT - 1, MAX_SHORT])
def test_a_shard_that_lacks_memory_is_done_again_and_not_for_ever(
    short: int, said_by: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    ray = StandInRay(free=True, born=True)
    lost: list[RowStatus] = []

    def get(event: Any) -> None:
        if event != "word":
            return
        if len(lost) == short:
            raise StopIteration  # the shard is done
        if said_by == "Ray":
            raise ray.exceptions.OutOfMemoryError("out of memory: its monitor says so: run fewer processes")
        error = ray.exceptions.RayTaskError()
        error.cause = OutOfMemoryError("out of memory: 2601 equations: run fewer processes")
        raise error

    ray.get = get
    monkeypatch.setitem(sys.modules, "ray", ray)
    monkeypatch.setattr(dispatch, "POLL_S", 0.0)
    configuration, fabrics = small_sweep()
    options = DispatchOptions(workers=1)
    driver = Dispatcher(str(tmp_path), configuration, fabrics, options, worker_class=ObedientWorker, lost=lost.append)
    if short < MAX_SHORT:
        driver.run([2])
    else:
        with pytest.raises(StoreError, match=r"shard 2 was tried 3 times: out of memory: .* fewer processes") as caught:
            driver.run([2])
        assert caught.value.code == "out_of_memory"
    assert lost == [RowStatus.CRASHED] * short
    assert ray.made == ray.killed == min(short + 1, MAX_SHORT)
