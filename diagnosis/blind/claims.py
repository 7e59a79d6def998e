"""Several processes share the cases of one blind check."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from diagnosis.blind.make import SHARED_BY

CLAIMS_FOLDER = "claims"


class Claims:
    """Which cases are this process's: whole groups that share drapes, given back when the process ends.

    A context manager; a claim is a lock on a file, which the operating system lifts from a process that dies.

    Args:
        out: folder of the check.
    """

    def __init__(self, out: Path) -> None:
        self._folder = out / CLAIMS_FOLDER
        self._held: set[int] = set()
        self._stack = ExitStack()

    def __enter__(self) -> Claims:
        self._folder.mkdir(exist_ok=True)
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def take(self, number: int) -> bool:
        """Whether a case, by its number from 0, is this process's, claimed now where nobody has it."""
        from filelock import FileLock, Timeout

        group = number // SHARED_BY
        if group in self._held:
            return True
        try:
            lock = FileLock(self._folder / f"group-{group + 1:02d}.lock").acquire(timeout=0)
        except Timeout:
            return False
        self._stack.enter_context(lock)
        self._held.add(group)
        return True


@contextmanager
def alone(out: Path, name: str, *, wait: bool) -> Iterator[bool]:
    """Whether a case's label is this process's to open, for the length of the block; ``wait``: until it is."""
    from filelock import FileLock, Timeout

    (out / CLAIMS_FOLDER).mkdir(exist_ok=True)
    lock = FileLock(out / CLAIMS_FOLDER / f"open-{name}.lock")
    try:
        lock.acquire(timeout=-1 if wait else 0)
    except Timeout:
        yield False
        return
    try:
        yield True
    finally:
        lock.release()
