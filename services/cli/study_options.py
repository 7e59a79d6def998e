"""What the subcommands of `drapemeter study` share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from simcore.errors import InputError

if TYPE_CHECKING:
    from services.db.engine import Database
    from services.web.study_store import StudyStore

DATABASE = typer.Option(None, "--database", help="Database; DRAPEMETER_DATABASE or sqlite:///drapemeter.db unless set.")
STUDY = typer.Argument(..., metavar="STUDY", help="Identifier of the study; 'drapemeter study list' shows them.")


@contextmanager
def open_database(url: str | None, *, make: bool = True) -> Iterator[Database]:
    """The database with its tables up to date; an embedded one is made as needed.

    Args:
        url: of the database; None: as the settings say.
        make: an embedded one that is not there may be made.

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
            if not make and (place := database.file) is not None and not place.exists():
                raise InputError(
                    f"{place}: no such database, so no study: give --database (`drapemeter study list` shows what one "
                    "holds)",
                    code="file_missing",
                )
            upgrade(database)
        else:
            require_current(database)
        yield database
    finally:
        database.close()


@contextmanager
def open_study(url: str | None, study: str) -> Iterator[StudyStore]:
    """A study in the database.

    Raises:
        InputError: no such study, or as :func:`open_database`.
    """
    from services.web.study_store import StudyStore as NewStore

    with open_database(url, make=False) as database:
        yield NewStore(database, study)
