"""The process that does the work: answers, refusals, crashes, stopping, recycling."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from services.jobs.child import ChildProcess
from services.jobs.task import Call, Crashed, Done, Event, Progress, Refused
from tests.services import job_functions


@pytest.fixture
def child() -> Iterator[ChildProcess]:
    made = ChildProcess("test", recycle_after=3)
    yield made
    made.stop()


def ending(child: ChildProcess) -> Event:
    """The event that ends a call."""
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        event = child.poll(0.1)
        if event is not None and not isinstance(event, Progress):
            return event
    raise AssertionError("no answer")


def test_a_result_a_refusal_and_a_mistake_come_back_as_what_they_are(child: ChildProcess) -> None:
    child.start(Call(job_functions.double, (21,)))
    assert ending(child) == Done(42)
    child.start(Call(job_functions.refuse))
    assert ending(child) == Refused("of_the_test", "give something else", bad_input=True)
    child.start(Call(job_functions.fall))
    assert ending(child) == Crashed("ended with exit status 1", again=False)
    child.start(Call(job_functions.double, (1,)))  # a new process
    assert ending(child) == Done(2)


@pytest.mark.parametrize("by", ["system", "writer"])
def test_a_full_disk_is_no_mistake_of_the_program(by: str, child: ChildProcess) -> None:
    child.start(Call(job_functions.fill, (by,)))
    event = ending(child)
    assert isinstance(event, Refused) and (event.code, event.bad_input) == ("no_room", False)
    assert "make room" in event.detail and "/somewhere" not in event.detail


@pytest.mark.parametrize(("given", "said"), [("Unable to allocate 2.0 GiB", "2.0 GiB"), ("", "no more")])
def test_too_little_memory_is_no_mistake_of_the_program(given: str, said: str, child: ChildProcess) -> None:
    child.start(Call(job_functions.grow, (given,)))
    event = ending(child)
    assert isinstance(event, Refused) and (event.code, event.bad_input) == ("out_of_memory", False)
    assert said in event.detail and "ask for less" in event.detail


def test_a_mistake_is_one_line_of_the_log_that_names_its_job(
    child: ChildProcess, capfd: pytest.CaptureFixture[str]
) -> None:
    child.start(Call(job_functions.fall, (), {"job": "job_1"}))
    assert ending(child) == Crashed("ended with exit status 1", again=False)
    (line,) = capfd.readouterr().err.splitlines()
    told = json.loads(line)
    assert (told["event"], told["level"], told["job"]) == ("unforeseen_error", "error", "job_1")
    assert "in fall" in told["exception"] and "ZeroDivisionError" in told["exception"]


def test_a_killed_process_may_be_tried_again(child: ChildProcess) -> None:
    child.start(Call(job_functions.die))
    assert ending(child) == Crashed("ended by SIGKILL", again=True)


def test_a_process_that_is_killed_in_the_middle_of_its_answer_may_be_tried_again(child: ChildProcess) -> None:
    child.start(Call(job_functions.tell_much))
    assert child._connection is not None and child._connection.poll(60)
    assert child._process is not None
    process = psutil.Process(child._process.pid)
    while process.status() == psutil.STATUS_RUNNING:  # until the pipe is full
        time.sleep(0.01)
    process.kill()
    assert ending(child) == Crashed("ended by SIGKILL", again=True)


def test_a_process_that_was_told_to_end_may_be_tried_again(child: ChildProcess, tmp_path: Path) -> None:
    child.start(Call(job_functions.sleep, (str(tmp_path / "mark"),)))
    while not (tmp_path / "mark.started").exists():
        assert child.poll(0.05) is None
    assert child._process is not None
    process = psutil.Process(child._process.pid)
    process.terminate()
    assert ending(child) == Crashed("told to stop", again=True)


def test_stopping_lets_the_work_clean_up(child: ChildProcess, tmp_path: Path) -> None:
    child.start(Call(job_functions.sleep, (str(tmp_path / "mark"),)))
    while not (tmp_path / "mark.started").exists():
        assert child.poll(0.05) is None
    child.stop()
    assert (tmp_path / "mark.tidied").exists()


def test_the_process_is_kept_and_replaced_after_some_calls(child: ChildProcess) -> None:
    found = []
    for _ in range(4):
        child.start(Call(job_functions.process_id))
        event = ending(child)
        assert isinstance(event, Done)
        found.append(event.value)
    assert found[0] == found[1] == found[2] != found[3]
    assert not psutil.pid_exists(found[0])
