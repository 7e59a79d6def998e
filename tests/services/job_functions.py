"""What children of the tests are asked to do."""

from __future__ import annotations

import errno
import os
import signal
import time
from pathlib import Path

from services.jobs.files import FileContent
from services.jobs.processes import run_worker
from services.jobs.task import Report, Task, TaskOutput
from services.settings import Settings
from simcore.errors import DrapemeterError, InputError


def double(value: int, *, report: Report) -> int:
    """Twice the value, with a word on the way."""
    report(0.5, "half way")
    return 2 * value


def refuse(*, report: Report) -> None:
    """As for input that cannot be used."""
    raise InputError("give something else", code="of_the_test")


def fall(*, report: Report) -> None:
    """A mistake that nobody foresaw."""
    raise ZeroDivisionError


def fill(by: str, *, report: Report) -> None:
    """A disk without room, as a file's writer tells it or as the system does."""
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/somewhere/on/the/server")
    if by == "system":
        raise full
    raise DrapemeterError("cannot write /somewhere/on/the/server", code="cannot_write") from full


def grow(said: str, *, report: Report) -> None:
    """More than memory holds."""
    raise MemoryError(said)


def die(*, report: Report) -> None:
    """As a crash in compiled code, or the kernel short of memory."""
    os.kill(os.getpid(), signal.SIGKILL)


def tell_much(*, report: Report) -> bytes:
    """More than a pipe holds."""
    return bytes(16 * 1024 * 1024)


def sleep(mark: str, *, report: Report) -> None:
    """For long; leaves a file when asked to end politely."""
    try:
        Path(f"{mark}.started").touch()
        time.sleep(600)
    finally:
        Path(f"{mark}.tidied").touch()


def process_id(*, report: Report) -> int:
    """Of the child."""
    return os.getpid()


def count_slowly(task: Task, *, report: Report) -> TaskOutput:
    """Stands in for a job's work: counts to ten, and leaves its process's number in the folder it is told."""
    folder = Path(task.inputs["folder"])
    (folder / f"process-{os.getpid()}").touch()
    for done in range(10):
        time.sleep(task.inputs["seconds"] / 10)
        report(done / 10, f"{done} of 10")
    return TaskOutput({"counted": 10}, (FileContent("report.html", "text/html", b"<p>done"),))


def work_slowly(settings: Settings) -> None:
    """A worker process whose jobs are :func:`count_slowly`."""
    run_worker(settings, count_slowly)
