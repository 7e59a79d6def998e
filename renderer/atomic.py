"""Files that are whole or not there."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from simcore.errors import DrapemeterError, InputError

NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
"""What a disk says that has no room left: a failure, not a place that was named wrongly."""


def write_atomically(path: Path | str, content: bytes) -> None:
    """Write a file through a temporary neighbour and a rename; an interrupted write leaves the old file.

    A link stays a link, and what it names is written; a device or a pipe is written to as it is.

    Raises:
        InputError: the folder does not exist or cannot be written.
        DrapemeterError: the disk is full.
    """
    prepare(path, content).put()


@dataclass(frozen=True)
class Prepared:
    """A file that is written, but not yet where it belongs; of a device or a pipe nothing is left to be done.

    Attributes:
        path: as it was named.
        part: the temporary neighbour.
        target: what takes its place.
    """

    path: Path
    part: Path | None
    target: Path

    def put(self) -> None:
        """Put it where it belongs.

        Raises:
            InputError: it cannot be.
        """
        if self.part is not None:
            with _told(self.path):
                _rename(self.part, self.target)

    def drop(self) -> None:
        """Take it away again."""
        if self.part is not None:
            with contextlib.suppress(OSError):
                self.part.unlink(missing_ok=True)


def prepare(path: Path | str, content: bytes) -> Prepared:
    """The first half of :func:`write_atomically`: everything that a full disk may refuse."""
    target = Path(path)
    with _told(target):
        if target.exists() and not target.is_file() and not target.is_dir():
            with target.open("wb") as stream:
                stream.write(content)
            return Prepared(target, None, target)
        real = Path(os.path.realpath(target))
        part = real.with_name(f".{secrets.token_hex(8)}.part")
        try:
            with part.open("xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
        except BaseException:  # an interruption, too
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
            raise
        return Prepared(target, part, real)


def is_part(path: Path) -> bool:
    """A file on its way to its place, by :func:`prepare`."""
    return path.name.startswith(".") and path.suffix == ".part"


def _rename(part: Path, target: Path) -> None:
    try:
        part.replace(target)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno in NO_ROOM:
            raise DrapemeterError(
                f"cannot write {path}: {error.strerror}; make room, or name another place", code="cannot_write"
            ) from error
        raise InputError(f"cannot write {path}: {error.strerror}", code="cannot_write") from error
