"""Ranks of a training that die or fail. Ray itself is not started."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import timedelta
from types import SimpleNamespace
from typing import Any

import pytest
from ray.exceptions import ActorDiedError, RayTaskError

from services.training import job
from simcore.errors import DrapemeterError, StoreError
from trainer.config import TrainConfig


def failed(cause: Exception) -> RayTaskError:
    """As Ray tells what a rank raised."""
    return RayTaskError("run", "Traceback ...", cause)


CUT_OFF = failed(RuntimeError("Connection closed by peer"))
"""What a rank says when another one has died."""
DAMAGED = failed(StoreError("damaged", code="store_damaged"))


@pytest.fixture
def ranks(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What each rank's run ends with, in the order in which it is heard of; whether a meeting place is found.

    Beside them, how many have no CPU (``absent``); how many are ended is counted (``killed``).
    """
    given: dict[str, Any] = {"runs": [], "place": "tcp://here:1", "absent": 0, "killed": 0}

    def actors() -> Iterator[SimpleNamespace]:
        for number in range(len(given["runs"])):
            calls = {"meeting_place": given["place"], "run": given["runs"][number], "progress": None}
            yield SimpleNamespace(
                **{name: SimpleNamespace(remote=lambda *_, end=end: [end]) for name, end in calls.items()}
            )

    def get(asked: list[Any]) -> Any:
        for end in asked:
            if isinstance(end, list):
                get(end)
            elif isinstance(end, Exception):
                raise end
        return asked[0] if asked else None

    def wait(runs: Sequence[Any], **options: Any) -> tuple[Sequence[Any], Sequence[Any]]:
        if options["timeout"] == job.START_ALLOWANCE_S:
            up = len(runs) - given["absent"]
            return runs[:up], runs[up:]
        return (runs, []) if "num_returns" in options else (runs[-1:], runs[:-1])

    made = actors()
    monkeypatch.setattr(
        "ray.remote", lambda kind: SimpleNamespace(options=lambda **_: SimpleNamespace(remote=lambda *_: next(made)))
    )
    monkeypatch.setattr("ray.get", get)
    monkeypatch.setattr("ray.wait", wait)
    monkeypatch.setattr("ray.kill", lambda actor: given.update(killed=given["killed"] + 1))
    return given


@pytest.mark.parametrize(
    ("runs", "rank"),
    [
        ([CUT_OFF, ActorDiedError()], 1),
        ([ActorDiedError(), CUT_OFF], 0),
        ([CUT_OFF, ActorDiedError(), CUT_OFF], 1),
    ],
)
def test_a_rank_that_dies_is_named_whoever_is_heard_first(
    ranks: dict[str, Any], runs: list[Exception], rank: int
) -> None:
    ranks["runs"] = runs
    with pytest.raises(DrapemeterError, match=rf"rank {rank} of the training died, and nothing was kept") as caught:
        job._train(["s.zarr"], TrainConfig(), None, len(runs), None)
    assert caught.value.code == "worker_died"


def test_a_rank_that_dies_before_they_meet_is_named(ranks: dict[str, Any]) -> None:
    ranks.update(runs=[None, None], place=ActorDiedError())
    with pytest.raises(DrapemeterError, match="rank 0 of the training died") as caught:
        job._train(["s.zarr"], TrainConfig(), None, 2, None)
    assert caught.value.code == "worker_died"


@pytest.mark.parametrize("runs", [[CUT_OFF, DAMAGED], [DAMAGED, CUT_OFF]])
def test_what_a_rank_says_is_told_as_it_is(ranks: dict[str, Any], runs: list[Exception]) -> None:
    ranks["runs"] = runs
    with pytest.raises(StoreError, match=r"^damaged$"):
        job._train(["s.zarr"], TrainConfig(), None, 2, None)


def test_a_fault_of_the_program_is_told_as_it_is(ranks: dict[str, Any]) -> None:
    ranks["runs"] = [CUT_OFF, CUT_OFF]
    with pytest.raises(RayTaskError) as caught:
        job._train(["s.zarr"], TrainConfig(), None, 2, None)
    assert caught.value is CUT_OFF


def test_ranks_that_find_no_cpu_are_not_waited_for_without_an_end(
    ranks: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    ranks.update(runs=[None, None, None], absent=2)
    monkeypatch.setattr("ray.cluster_resources", lambda: {"CPU": 3.0})
    told = "2 of 3 ranks have not come up in 900 s: they need 2 free CPUs each, and the cluster has 3 in all"
    with pytest.raises(StoreError, match=told) as caught:
        job._train(["s.zarr"], TrainConfig(threads=2), None, 3, None)
    assert caught.value.code == "workers_missing" and ranks["killed"] == 3


def test_ranks_that_cannot_meet_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing listens at port 9."""
    monkeypatch.setattr(job, "MEETING", timedelta(seconds=1))
    with pytest.raises(DrapemeterError, match=r"rank 1 .* has not met the others at tcp://127\.0\.0\.1:9 \(") as caught:
        job.TrainingRank(["s.zarr"], TrainConfig(), None, 1, 2).run("tcp://127.0.0.1:9")
    assert caught.value.code == "ranks_apart"
