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
def open_database(url: str | None, *, make: bool = True) -> Iterator[Database]:
    """The database of studies; an embedded one that is not there is made if it may be.

    Raises:
        InputError, MissingResourceError: as :func:`services.cli.database.open_database`.
    """
    from services.cli import database

    missing = "no such database, so no study: give --database (`drapemeter study list` shows what one holds)"
    with database.open_database(url, missing=None if make else missing) as opened:
        yield opened


@contextmanager
def open_study(url: str | None, study: str) -> Iterator[StudyStore]:
    """A study in the database.

    Raises:
        InputError: no such study, or as :func:`open_database`.
    """
    from services.web.study_store import StudyStore as NewStore

    with open_database(url, make=False) as database:
        yield NewStore(database, study)
