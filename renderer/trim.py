"""A folder of files that can be made again, kept below a size."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def mark_used(path: Path) -> None:
    """Note that a file was of use now; one that may not be changed stays as it is."""
    with contextlib.suppress(OSError):
        os.utime(path)


def trim_folder(folder: Path, most_bytes: int, suffix: str) -> int:
    """Delete what was not used for longest until the rest takes ``most_bytes`` at most.

    Files that another process removes meanwhile, or that may not be removed, are passed over.

    Args:
        folder: it and the folders in it; one that is not there is empty.
        most_bytes: how much may stay.
        suffix: of the files that count (``.npz``); others are left alone.

    Returns:
        How many files were deleted.
    """
    found = []
    for path in folder.rglob(f"*{suffix}"):
        with contextlib.suppress(OSError):
            facts = path.stat()
            found.append((facts.st_mtime, facts.st_size, path))
    total = sum(size for _, size, _ in found)
    deleted = 0
    for _, size, path in sorted(found):
        if total <= most_bytes:
            break
        with contextlib.suppress(OSError):
            path.unlink()
            deleted += 1
        total -= size
    return deleted
