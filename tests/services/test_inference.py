"""The process that estimates, as the server sees it: a full queue, and an end in the middle of the work."""

from __future__ import annotations

import asyncio
import errno
import os
import threading
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from services.api import inference
from services.api.inference import Inference, InferenceBusyError
from services.api.problems import install_problem_handlers
from services.jobs.task import Call, Crashed, Done, Event, Refused
from simcore.errors import MissingResourceError


class EndlessChild:
    """Stands for the process: it begins and is never done."""

    def __init__(self, name: str, **_: Any) -> None:
        self.begun = threading.Event()
        self.stopped = False

    def start(self, call: Call) -> None:
        self.begun.set()

    def poll(self, timeout_s: float) -> None:
        threading.Event().wait(0.01)

    def stop(self) -> None:
        self.stopped = True


async def _asked(queue: int) -> tuple[Inference, EndlessChild, list[asyncio.Task[object]]]:
    """As many estimates as are taken, of which the first is under way."""
    running = Inference(queue=queue, timeout_s=60.0)
    child = running._child
    assert isinstance(child, EndlessChild)
    waiting = [asyncio.create_task(running.run(Call(abs, (-1,)))) for _ in range(queue)]
    await asyncio.to_thread(child.begun.wait, 30)
    return running, child, waiting


def test_whoever_waits_is_told_of_the_servers_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inference, "ChildProcess", EndlessChild)

    async def ask() -> EndlessChild:
        running, child, (waiting,) = await _asked(1)
        with pytest.raises(InferenceBusyError, match="too many estimates are waiting") as busy:
            await running.run(Call(abs, (-1,)))
        assert busy.value.code == "estimates_saturated" and busy.value.retry_after_s >= 1
        await asyncio.to_thread(running.close)
        with pytest.raises(MissingResourceError, match="shutting down: try again") as ended:
            await waiting
        assert ended.value.code == "shutting_down"
        return child

    assert asyncio.run(ask()).stopped


class PromptChild(EndlessChild):
    """Ends each call at once."""

    def __init__(self, answer: Event) -> None:
        super().__init__("prompt")
        self.answer = answer

    def poll(self, timeout_s: float) -> Event:  # type: ignore[override]  # the other never has one
        return self.answer


def test_estimates_end_before_the_server_cuts_requests_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those under way, those that wait, and those that come."""
    monkeypatch.setattr(inference, "ChildProcess", EndlessChild)

    async def ask() -> None:
        running, _, waiting = await _asked(2)
        running.ask_to_end(0.0)
        for task in (*waiting, asyncio.create_task(running.run(Call(abs, (-1,))))):
            with pytest.raises(MissingResourceError, match="shutting down: try again") as ended:
                await task
            assert ended.value.code == "shutting_down"
        running.close()
        running.close()

    asyncio.run(ask())


@pytest.mark.parametrize(("answer", "told"), [(Done(42), None), (Crashed("told to stop", again=True), "shutting_down")])
def test_an_estimate_may_end_while_the_server_does(
    answer: Event, told: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless its process was told to end as well, as a service manager tells all at once."""
    monkeypatch.setattr(inference, "ChildProcess", lambda name, **_: PromptChild(answer))
    running = Inference(queue=1, timeout_s=60.0)
    running.ask_to_end(60.0)
    if told is None:
        assert asyncio.run(running.run(Call(abs, (-1,)))) == 42
    else:
        with pytest.raises(MissingResourceError) as ended:
            asyncio.run(running.run(Call(abs, (-1,))))
        assert ended.value.code == told
    running.close()


def test_the_time_of_an_estimate_is_that_in_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is refused took none."""
    monkeypatch.setattr(inference, "ChildProcess", lambda name, **_: PromptChild(Done(42)))
    seconds: list[float] = []

    async def ask() -> None:
        running = Inference(queue=1, timeout_s=60.0, observe=seconds.append)
        first = asyncio.create_task(running.run(Call(abs, (-1,))))
        await asyncio.sleep(0)
        with pytest.raises(InferenceBusyError):
            await running.run(Call(abs, (-1,)))
        assert await first == 42
        running.close()

    asyncio.run(ask())
    assert len(seconds) == 1


def asked_of_a_server(running: Inference) -> tuple[int, str, str]:
    """Status, code and `Retry-After` of a route that asks for an estimate."""
    app = FastAPI()
    install_problem_handlers(app)

    @app.get("/")
    async def estimate() -> Any:
        return await running.run(Call(abs, (-1,)))

    answer = TestClient(app).get("/")
    return answer.status_code, answer.json()["code"], answer.headers["retry-after"]


@pytest.mark.parametrize("lack", [errno.EAGAIN, errno.ENOMEM, errno.EMFILE])
def test_a_machine_without_a_process_to_spare_says_when_to_come_back(
    lack: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Unborn(PromptChild):
        def start(self, call: Call) -> None:
            if not self.stopped:
                raise OSError(lack, os.strerror(lack))

    child = Unborn(Done(42))
    monkeypatch.setattr(inference, "ChildProcess", lambda name, **_: child)
    running = Inference(queue=1, timeout_s=60.0)
    assert asked_of_a_server(running) == (503, "no_process", "60")
    assert child.stopped  # what was half begun is ended, and the next one begins afresh
    assert asyncio.run(running.run(Call(abs, (-1,)))) == 42
    running.close()


def test_an_estimate_without_memory_says_when_to_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    short = Refused("out_of_memory", "out of memory: ask for less at once", bad_input=False)
    monkeypatch.setattr(inference, "ChildProcess", lambda name, **_: PromptChild(short))
    running = Inference(queue=1, timeout_s=60.0)
    assert asked_of_a_server(running) == (503, "out_of_memory", "60")
    running.close()
