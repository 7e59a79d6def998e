"""What the subcommands of `drapemeter study` share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from services.db.engine import Database
    from services.web.study_store import StudyStore

DATABASE = typer.Option(None, "--database", help="Database; DRAPEMETER_DATABASE or sqlite:///drapemeter.db unless set.")
STUDY = typer.Argument(..., metavar="STUDY", help="Identifier of the study; 'drapemeter study list' shows them.")


@contextmanager
def open_database(url: str | None) -> Iterator[Database]:
    """The database with its tables up to date; an embedded one is made as needed.

    Raises:
        InputError: an unusable URL.
        MissingResourceError: it cannot be reached, or a shared one has the tables of another version.
    """
    from services.cli.serve import load_settings
    from services.db.engine import Database as NewDatabase
    from services.db.migrate import require_current, upgrade

    database = NewDatabase(load_settings({"database": url}).database)
    try:
        if database.is_sqlite:
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

    with open_database(url) as database:
        yield NewStore(database, study)
