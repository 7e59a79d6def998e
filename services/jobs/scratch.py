"""Folders that processes work in; those of processes that were killed are cleared by the next worker.

A folder is locked by the process that made it, and a lock ends with its process however that ends. The number of a
process would say nothing: in a container the next one has the same.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PREFIX = "drapemeter-scratch-"

_held: dict[Path, int] = {}


def make_scratch() -> Path:
    """An empty folder that is this process's until it ends."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX))
        try:
            _held[folder] = _locked(folder)
        except (FileNotFoundError, BlockingIOError):  # another process was just clearing, and has taken ours, too
            continue
        except OSError:  # a place without locks, where nothing is cleared
            pass
        return folder


def remove_scratch(folder: Path) -> None:
    """Away with it, whatever is in it."""
    shutil.rmtree(folder, ignore_errors=True)
    handle = _held.pop(folder, None)
    if handle is not None:
        os.close(handle)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Such a folder for the time of a block."""
    folder = make_scratch()
    try:
        yield folder
    finally:
        remove_scratch(folder)


def clear_abandoned() -> int:
    """Remove folders of this machine's processes that live no more; returns how many."""
    count = 0
    try:
        place = Path(tempfile.gettempdir())
    except FileNotFoundError:  # no folder can be written to, as each job will say while it waits
        return count
    for folder in place.glob(f"{PREFIX}*"):
        try:
            handle = _locked(folder)
        except OSError:  # in use, another user's, or gone meanwhile
            continue
        shutil.rmtree(folder, ignore_errors=True)
        os.close(handle)
        count += 1
    return count


def _locked(folder: Path) -> int:
    """A descriptor of a folder with its lock.

    Raises:
        BlockingIOError: another has it.
        FileNotFoundError: the folder is gone.
        OSError: it cannot be locked.
    """
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        folder.stat()  # one that was removed can be locked, too
    except OSError:
        os.close(handle)
        raise
    return handle
