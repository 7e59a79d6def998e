"""The database of a command: the one that is named, or that of the settings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from simcore.errors import InputError

if TYPE_CHECKING:
    from services.db.engine import Database


@contextmanager
def open_database(url: str | None, *, missing: str | None) -> Iterator[Database]:
    """The database with its tables up to date.

    Args:
        url: of the database; None: as the settings say.
        missing: what to say where an embedded one is not there; None: it is made then.

    Raises:
        InputError: an unusable URL, or a database that is not there and may not be made.
        MissingResourceError: it cannot be reached, or a shared one has the tables of another version.
    """
    from services.cli.serve import load_settings
    from services.db.engine import Database as NewDatabase
    from services.db.migrate import require_current, upgrade

    database = NewDatabase(load_settings({"database": url}).database)
    try:
        if database.is_sqlite:
            if missing is not None and (place := database.file) is not None and not place.exists():
                raise InputError(f"{place}: {missing}", code="file_missing")
            upgrade(database)
        else:
            require_current(database)
        yield database
    finally:
        database.close()
