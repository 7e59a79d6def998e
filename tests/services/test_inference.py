"""The process that estimates, as the server sees it: a full queue, and an end in the middle of the work."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest

from services.api import inference
from services.api.inference import Inference, InferenceBusyError
from services.jobs.task import Call, Crashed, Done, Event
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
