"""What passes between a worker and the process that does the work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from services.jobs.files import FileContent


class Report(Protocol):
    """How work tells how far it is; cheap enough to call often."""

    def __call__(self, fraction: float, message: str = "") -> None:
        """``fraction`` of the whole, 0 to 1."""


@dataclass(frozen=True)
class Resources:
    """What the service gives its jobs, whoever asked for them.

    Attributes:
        dataset_root: folder or URL under which datasets are written.
        ray_address: cluster that spreads a job's work; None for this machine alone.
        model: folder of the estimator; None for the one that ships.
    """

    dataset_root: str = "datasets"
    ray_address: str | None = None
    model: Path | None = None


@dataclass(frozen=True)
class Task:
    """One job to do, with all it needs; ``scratch`` is an empty folder that is removed afterwards."""

    job_id: str
    kind: str
    inputs: dict[str, Any]
    files: tuple[FileContent, ...]
    resources: Resources
    scratch: Path

    def file(self, name: str) -> bytes:
        """Content of an input file."""
        return next(f.content for f in self.files if f.name == name)


@dataclass(frozen=True)
class TaskOutput:
    """What a job leaves: a JSON result and files."""

    result: dict[str, Any]
    files: tuple[FileContent, ...] = ()


@dataclass(frozen=True)
class Call:
    """A function of a module, importable in another process, and its arguments; it also gets ``report=``.

    ``about`` stands in the log lines of the process meanwhile.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    about: dict[str, str] = field(default_factory=dict)


NO_ROOM = "no_room"
"""Code of a job that found its disk full."""


@dataclass(frozen=True)
class Progress:
    """Still at work."""

    fraction: float
    message: str = ""


@dataclass(frozen=True)
class Done:
    """The function returned."""

    value: Any


@dataclass(frozen=True)
class Refused:
    """The function raised one of the project's errors: the same again would fail again."""

    code: str
    detail: str
    bad_input: bool


@dataclass(frozen=True)
class Crashed:
    """The process ended without an answer; ``again`` says whether another try may help."""

    reason: str
    again: bool


Event = Progress | Done | Refused | Crashed


class Runner(Protocol):
    """Something that executes one call at a time outside this process."""

    def start(self, call: Call) -> None:
        """Begin; only when nothing is under way."""

    def poll(self, timeout_s: float) -> Event | None:
        """The next event, or None when nothing happened for so long."""

    def stop(self) -> None:
        """End whatever is under way and everything it started; a later :meth:`start` begins afresh."""


@dataclass
class Throttle:
    """Lets a report through at most every ``interval_s`` seconds."""

    interval_s: float = 0.5
    _last: float = field(default=float("-inf"))

    def ready(self, now: float) -> bool:
        """Whether the next may pass."""
        if now - self._last < self.interval_s:
            return False
        self._last = now
        return True
