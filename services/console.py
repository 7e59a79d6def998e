"""What commands print: JSON documents and text on standard output, progress and notes on standard error."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

from services.plain_json import to_plain

_document_stream: TextIO | None = None
_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
"""Control characters but tabulator and line feed, and those that turn the direction of writing."""


class ProgressBar:
    """Handle of a running bar; a no-op where standard error is no terminal."""

    def __init__(self, bar: Any = None, task: Any = None) -> None:
        self._bar = bar
        self._task = task

    def advance(self, steps: float = 1.0) -> None:
        """Move on by ``steps``."""
        if self._bar is not None:
            self._bar.advance(self._task, steps)

    def update(
        self, *, completed: float | None = None, total: float | None = None, description: str | None = None
    ) -> None:
        """Set the state outright."""
        if self._bar is not None:
            self._bar.update(self._task, completed=completed, total=total, description=description)


@contextmanager
def progress(description: str, total: float | None = None) -> Iterator[ProgressBar]:
    """A progress bar with time elapsed and to go on standard error, only if that is a terminal.

    Args:
        description: what is under way.
        total: number of steps; None while unknown.
    """
    if not sys.stderr.isatty():
        yield ProgressBar()
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        yield ProgressBar(bar, bar.add_task(description, total=total))


def say(message: str = "") -> None:
    """One line of the command's result for people, on standard output."""
    sys.stdout.write(_shown(message) + "\n")
    sys.stdout.flush()


def note(message: str) -> None:
    """One line about the way there, on standard error."""
    sys.stderr.write(_shown(message) + "\n")
    sys.stderr.flush()


def _shown(message: str) -> str:
    """With escapes for what is no text (a file's name may be none) and for what would steer a terminal."""
    text = message.encode(errors="backslashreplace").decode()
    return _STEERING.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def error_line(message: str, code: str) -> None:
    """The one line that a failed command leaves on standard error."""
    note(f"error: {' '.join(message.split())} [{code}]")


def emit_json(value: object) -> None:
    """Write ``value`` as the command's one JSON document on standard output.

    Dataclasses, pydantic models, enums, paths and NumPy values are converted; numbers that JSON cannot hold (NaN,
    infinity) become null.
    """
    stream = _document_stream if _document_stream is not None else sys.stdout
    plain = to_plain(value)
    text = json.dumps(plain, allow_nan=False, ensure_ascii=False)
    if not _is_text(text):  # a file's name that is none: as escapes, which JSON allows
        text = json.dumps(plain, allow_nan=False)
    stream.write(text + "\n")
    stream.flush()


def _is_text(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


@contextmanager
def document_only() -> Iterator[None]:
    """Reserve standard output for :func:`emit_json`.

    Libraries greet and warn on standard output, some from compiled code; until the end of the block all of that goes to
    standard error, so that what a program reads is the JSON document alone.
    """
    global _document_stream
    original = sys.stdout
    original.flush()
    saved = os.dup(1) if _is_process_stdout(original) else None
    _document_stream = os.fdopen(os.dup(saved), "w", encoding="utf-8") if saved is not None else original
    sys.stdout = sys.stderr
    if saved is not None:
        os.dup2(2, 1)
    try:
        yield
    finally:
        with suppress(OSError):  # what did not go through was told when it was written
            _document_stream.flush()
        if saved is not None:
            with suppress(OSError):
                _document_stream.close()
            os.dup2(saved, 1)
            os.close(saved)
        _document_stream = None
        sys.stdout = original


def _is_process_stdout(stream: TextIO) -> bool:
    try:
        return stream.fileno() == 1
    except (OSError, ValueError):
        return False  # replaced by a buffer, as tests do
