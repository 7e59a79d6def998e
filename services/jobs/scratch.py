"""Folders that a job's process works in; those of workers that were killed are cleared by the next."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from pathlib import Path

NAME = re.compile(r"drapemeter-job-(\d+)-.*")


def make_scratch() -> Path:
    """An empty folder that says whose it is."""
    return Path(tempfile.mkdtemp(prefix=scratch_prefix()))


def scratch_prefix() -> str:
    """How such a folder's name begins; without its process it is cleared by the next worker."""
    return f"drapemeter-job-{os.getpid()}-"


def remove_scratch(folder: Path) -> None:
    """Away with it, whatever is in it."""
    shutil.rmtree(folder, ignore_errors=True)


def clear_abandoned() -> int:
    """Remove folders of this machine's workers that live no more; returns how many."""
    count = 0
    for folder in Path(tempfile.gettempdir()).glob("drapemeter-job-*"):
        match = NAME.fullmatch(folder.name)
        if match is not None and not _lives(int(match.group(1))):
            remove_scratch(folder)
            count += 1
    return count


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
