"""A spawned process that does heavy work and can be stopped at any moment.

Simulators and networks compile once in a process, must not share one with the web server, and may crash it; so they
live here. The process is kept between calls and replaced after a crash, a stop, or a number of calls.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.connection
import signal
import sys
import threading
import time
from types import FrameType

import structlog

from renderer.atomic import NO_ROOM as DISK_FULL
from services.jobs.task import NO_ROOM, Call, Crashed, Done, Event, Progress, Refused, Report, Throttle
from services.logs import configure_logging
from simcore.errors import DrapemeterError, InputError, OutOfMemoryError
from simcore.parent import end_with_parent

STOP_GRACE_S = 10.0
"""Time between asking a process to end and killing it."""
STOPPED = 128 + signal.SIGTERM
"""Exit status of a process that was told to end."""

_FULL = Refused(
    NO_ROOM, "no room is left on a disk of the service: make room in its caches' folder and in TMPDIR", False
)

log = structlog.get_logger("drapemeter.job")


class ChildProcess:
    """A :class:`~services.jobs.task.Runner` on this machine. Not thread-safe.

    Args:
        name: for process lists.
        recycle_after: calls after which the process is replaced, which bounds what a leak can take.
        log_level: of the process, see :func:`services.logs.configure_logging`.
    """

    def __init__(self, name: str, *, recycle_after: int = 100, log_level: str = "info") -> None:
        self._name = name
        self._recycle_after = recycle_after
        self._log_level = log_level
        self._calls = 0
        self._process: multiprocessing.process.BaseProcess | None = None
        self._connection: multiprocessing.connection.Connection | None = None

    def start(self, call: Call) -> None:
        """Begin a call, in a new process where there is none or the old one is worn out."""
        if self._process is not None and (self._calls >= self._recycle_after or not self._process.is_alive()):
            self.stop()
        if self._process is None:
            self._launch()
        self._calls += 1
        assert self._connection is not None
        with contextlib.suppress(BrokenPipeError):  # it has just died: poll() says so
            self._connection.send(call)

    def poll(self, timeout_s: float) -> Event | None:
        """The next event of the running call."""
        process, connection = self._process, self._connection
        if process is None or connection is None:
            raise RuntimeError("poll() without start()")
        try:
            if not connection.poll(timeout_s):
                return None
            event: Event = connection.recv()
        except (EOFError, OSError):  # the latter where it ended in the middle of a message
            return self._bury(process)
        return event

    def stop(self) -> None:
        """End the process: politely first, so that it can clean up, then for certain."""
        process, connection = self._process, self._connection
        self._process = self._connection = None
        if process is None:
            return
        process.terminate()
        process.join(STOP_GRACE_S)
        if process.is_alive():
            process.kill()
            process.join()
        if connection is not None:
            connection.close()
        process.close()

    def _launch(self) -> None:
        spawn = multiprocessing.get_context("spawn")
        ours, theirs = spawn.Pipe()
        process = spawn.Process(target=serve_calls, args=(theirs, self._log_level), name=self._name)
        process.start()
        theirs.close()
        self._process, self._connection, self._calls = process, ours, 0

    def _bury(self, process: multiprocessing.process.BaseProcess) -> Crashed:
        process.join(STOP_GRACE_S)
        code = process.exitcode
        self.stop()
        if code is not None and code < 0:
            return Crashed(f"ended by {signal.Signals(-code).name}", again=True)
        if code == STOPPED:
            return Crashed("told to stop", again=True)
        # An exception that nobody foresaw: its traceback is in the log, and it would come again.
        return Crashed(f"ended with exit status {code}", again=False)


def serve_calls(connection: multiprocessing.connection.Connection, log_level: str) -> None:
    """Body of the child: one call after another on the main thread, until the parent hangs up."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C is the server's to handle
    signal.signal(signal.SIGTERM, _leave)
    end_with_parent()
    configure_logging(log_level)
    lock, throttle = threading.Lock(), Throttle()

    def send(event: Event) -> None:
        with lock:
            connection.send(event)

    def report(fraction: float, message: str = "") -> None:
        if throttle.ready(time.monotonic()):
            send(Progress(fraction, message))

    while True:
        try:
            call: Call = connection.recv()
        except EOFError:
            return
        with structlog.contextvars.bound_contextvars(**call.about):
            try:
                send(_outcome(call, report))
            except Exception:  # the outermost frame: what nobody foresaw ends the process, and is told
                log.exception("unforeseen_error")
                sys.exit(1)


def _outcome(call: Call, report: Report) -> Done | Refused:
    try:
        return Done(call.function(*call.arguments, report=report))
    except DrapemeterError as error:
        if error.code == "cannot_write" and _is_full(error.__cause__):
            return _FULL
        return Refused(error.code, str(error), isinstance(error, InputError))
    except OSError as error:
        if _is_full(error):
            return _FULL
        raise
    except MemoryError as error:
        said = " ".join(str(error).split()) or "Python could get no more"
        log.error("out_of_memory", error=said)
        text = f"out of memory ({said}): ask for less at once (coarser cells, smaller pictures), or try again later"
        return Refused(OutOfMemoryError.code, text, False)


def _is_full(error: BaseException | None) -> bool:
    return isinstance(error, OSError) and error.errno in DISK_FULL


def _leave(_signal: int, _frame: FrameType | None) -> None:
    sys.exit(STOPPED)
