"""What the side programs `python -m trainer...` share."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile

from renderer.atomic import NO_ROOM
from simcore.errors import DrapemeterError, InputError


def make_results_folder(folder: Path) -> None:
    """Make the folder for results and try to write there, before the work that fills it.

    Raises:
        InputError: it cannot be made or written to.
        OSError: the disk is full.
    """
    done = "made"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        done = "written to"
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        if error.errno in NO_ROOM:
            raise
        raise InputError(
            f"{folder}: cannot be {done} ({error.strerror}); name another", code="folder_unusable"
        ) from None


@contextmanager
def told_in_one_line() -> Iterator[None]:
    """End the program as `drapemeter` does: one line on standard error, exit status 2 for bad input, else 1.

    A full disk is told so, too; any other failure of reading or writing is nobody's foresight and shows where it is.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in NO_ROOM:
            raise
        said = f"{error.filename or 'what the program writes'}: {error.strerror}; make room, or name another place"
        sys.stderr.write(f"error: {said} [cannot_write]\n")
        raise SystemExit(1) from None
    except DrapemeterError as error:
        sys.stderr.write(f"error: {' '.join(str(error).split())} [{error.code}]\n")
        raise SystemExit(2 if isinstance(error, InputError) else 1) from None
