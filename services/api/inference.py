"""Estimates in a process of their own: bounded, timed, replaced when it hangs or crashes."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import structlog

from services.jobs.child import ChildProcess
from services.jobs.task import Call, Crashed, Done, Progress, Refused
from simcore.errors import DrapemeterError, InputError, MissingResourceError

POLL_S = 0.2

log = structlog.get_logger("drapemeter.api")


class InferenceBusyError(DrapemeterError):
    """Too many wait already; ``retry_after_s`` is a fair time to come back."""

    code = "estimates_saturated"

    def __init__(self, retry_after_s: int) -> None:
        super().__init__("too many estimates are waiting: try again later")
        self.retry_after_s = retry_after_s


class InferenceTimeoutError(DrapemeterError):
    """The estimate took too long and was stopped."""

    code = "estimate_timed_out"


class Inference:
    """One spawned process that computes one estimate at a time, and a short queue before it.

    Args:
        queue: how many may be under way or waiting.
        timeout_s: how long one may compute.
        observe: told the seconds that each estimate took in the process.
        log_level: of the process.
    """

    def __init__(
        self,
        *,
        queue: int,
        timeout_s: float,
        observe: Callable[[float], None] = lambda seconds: None,
        log_level: str = "info",
    ) -> None:
        self._queue = queue
        self._timeout_s = timeout_s
        self._observe = observe
        self._under_way = 0
        self._seconds = 1.0
        self._ends_at = math.inf
        self._child = ChildProcess("drapemeter-inference", recycle_after=10_000, log_level=log_level)
        # One thread waits on the process's pipe; it computes nothing, and its own queue keeps the order.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="inference-wait")

    async def run(self, call: Call) -> Any:
        """Compute in the process.

        Raises:
            InferenceBusyError: the queue is full.
            InferenceTimeoutError: it took too long.
            InputError: the input cannot be used.
            MissingResourceError: the server shuts down, or its machine has no process or no memory for it.
            DrapemeterError: another failure.
        """
        self._refuse_at_the_end()
        if self._under_way >= self._queue:
            raise InferenceBusyError(max(1, round(self._seconds * self._under_way)))
        self._under_way += 1
        future = asyncio.get_running_loop().run_in_executor(self._thread, self._compute, call)
        # Counted down when the work ends, not when a caller gives up: the process is busy until then.
        future.add_done_callback(self._ended)
        return await asyncio.shield(future)

    def ask_to_end(self, within_s: float) -> None:
        """What has not ended in this time is refused, whether it is under way or waits; returns at once."""
        self._ends_at = min(self._ends_at, time.monotonic() + within_s)

    def close(self) -> None:
        """End the process, and tell whoever waits; closing twice does no harm."""
        self.ask_to_end(0.0)
        self._thread.shutdown(wait=True)  # what waits is begun, and refused
        self._child.stop()

    def _refuse_at_the_end(self) -> None:
        if time.monotonic() >= self._ends_at:
            raise self._shutting_down()

    def _shutting_down(self) -> MissingResourceError:
        return MissingResourceError("the server is shutting down: try again", code="shutting_down")

    def _ended(self, future: asyncio.Future[Any]) -> None:
        self._under_way -= 1
        if not future.cancelled():
            future.exception()  # whoever waits gets it; when nobody does, it is no news

    def _compute(self, call: Call) -> Any:
        self._refuse_at_the_end()
        started = time.monotonic()
        self._begin(call)
        while True:
            event = self._child.poll(POLL_S)
            waited = time.monotonic() - started
            match event:
                case None | Progress():
                    self._refuse_at_the_end()
                    if waited > self._timeout_s:
                        self._child.stop()
                        raise InferenceTimeoutError(
                            f"the estimate took more than {self._timeout_s:g} s and was stopped"
                        )
                case Done(value):
                    self._seconds = 0.8 * self._seconds + 0.2 * waited
                    self._observe(waited)
                    return value
                case Refused(code, detail, True):
                    raise InputError(detail, code=code)
                case Refused(code, detail, False):
                    raise MissingResourceError(detail, code=code)
                case Crashed(again=True) if self._ends_at < math.inf:  # a signal to all processes ends this one, too
                    raise self._shutting_down()
                case Crashed(reason):
                    raise DrapemeterError(
                        f"the inference process {reason}; see the server's log", code="internal_error"
                    )

    def _begin(self, call: Call) -> None:
        """Raises :class:`MissingResourceError` where the machine has no process, memory or file to spare."""
        try:
            self._child.start(call)
        except OSError as error:
            log.error("inference_not_started", error=str(error))
            self._child.stop()  # whatever there is of it: the next begins afresh
            raise MissingResourceError(
                f"no process to estimate in ({error.strerror or error}): try again in a while, or free memory or "
                "processes on the machine of the service",
                code="no_process",
            ) from error
