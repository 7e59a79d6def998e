"""Files that are whole or not there."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from simcore.errors import InputError


def write_atomically(path: Path | str, content: bytes) -> None:
    """Write a file through a temporary neighbour and a rename; an interrupted write leaves the old file.

    Raises:
        InputError: the folder does not exist, cannot be written, or the disk is full.
    """
    target = Path(path)
    part = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    try:
        with part.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(target)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"cannot write {target}: {error.strerror}", code="cannot_write") from error
