"""The process that estimates, as the server sees it: a full queue, and an end in the middle of the work."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest

from services.api import inference
from services.api.inference import Inference, InferenceBusyError
from services.jobs.task import Call
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


def test_whoever_waits_is_told_of_the_servers_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inference, "ChildProcess", EndlessChild)

    async def ask() -> EndlessChild:
        running = Inference(queue=1, timeout_s=60.0)
        child = running._child
        assert isinstance(child, EndlessChild)
        waiting = asyncio.create_task(running.run(Call(abs, (-1,))))
        await asyncio.to_thread(child.begun.wait, 30)
        with pytest.raises(InferenceBusyError, match="too many estimates are waiting") as busy:
            await running.run(Call(abs, (-1,)))
        assert busy.value.code == "estimates_saturated" and busy.value.retry_after_s >= 1
        await asyncio.to_thread(running.close)
        with pytest.raises(MissingResourceError, match="shutting down: try again") as ended:
            await waiting
        assert ended.value.code == "shutting_down"
        return child

    assert asyncio.run(ask()).stopped
