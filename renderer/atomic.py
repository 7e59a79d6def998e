"""Files that are whole or not there."""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from simcore.errors import InputError


def write_atomically(path: Path | str, content: bytes) -> None:
    """Write a file through a temporary neighbour and a rename; an interrupted write leaves the old file.

    A link stays a link, and what it names is written; a device or a pipe is written to as it is.

    Raises:
        InputError: the folder does not exist, cannot be written, or the disk is full.
    """
    target = Path(path)
    try:
        if target.exists() and not target.is_file() and not target.is_dir():
            with target.open("wb") as stream:
                stream.write(content)
            return
        _replace(Path(os.path.realpath(target)), content)
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror}", code="cannot_write") from error


def _replace(target: Path, content: bytes) -> None:
    part = target.with_name(f".{secrets.token_hex(8)}.part")
    try:
        with part.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(target)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise
