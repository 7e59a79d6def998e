"""Bringing the tables up to date with alembic; the migrations are part of the package."""

from __future__ import annotations

import os
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from simcore.errors import MissingResourceError

if TYPE_CHECKING:
    from alembic.config import Config
    from alembic.script import ScriptDirectory
    from sqlalchemy import Connection

    from services.db.engine import Database

MIGRATION_LOCK = 0x64726170656D
"""Advisory lock that keeps two servers from migrating PostgreSQL at once (the letters 'drapem')."""


def upgrade(database: Database) -> None:
    """Run the missing migrations; several processes may call this at once.

    Raises:
        MissingResourceError: the database cannot be reached, or its tables are of a later version.
    """
    from alembic import command
    from sqlalchemy import text

    if database.file is not None:
        _make_private(database.file)
    database.ping()
    config = _config()
    with database.engine.execution_options(write=True).begin() as connection:
        if not database.is_sqlite:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": MIGRATION_LOCK})
        if _heads(connection) - _known():
            raise _of_later_version(database)
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


def is_current(database: Database) -> bool:
    """Whether the tables are those of this version of the software."""
    with database.engine.connect() as connection:
        return _heads(connection) == _own_heads()


def is_usable(database: Database) -> bool:
    """Whether this version of the software can go on serving from the tables: they are its own, or of a later version,
    whose migrations leave the version before it working while it is replaced.
    """
    with database.engine.connect() as connection:
        heads = _heads(connection)
    return bool(heads) and (heads == _own_heads() or not heads & _known())


def require_current(database: Database) -> None:
    """Check before serving.

    Raises:
        MissingResourceError: the database cannot be reached, or its tables are of another version.
    """
    database.ping()
    with database.engine.connect() as connection:
        later = _heads(connection) - _known()
    if later:
        raise _of_later_version(database)
    if not is_current(database):
        raise MissingResourceError(
            f"the tables of {database.public_url} are of another version: run 'drapemeter serve --migrate' first",
            code="database_not_migrated",
        )


def _of_later_version(database: Database) -> MissingResourceError:
    return MissingResourceError(
        f"the tables of {database.public_url} are of a later version: start that version, or name another database",
        code="database_later_version",
    )


def _heads(connection: Connection) -> set[str]:
    """Where the tables are; nothing where there are none."""
    from alembic.migration import MigrationContext

    return set(MigrationContext.configure(connection).get_current_heads())


@cache
def _known() -> frozenset[str]:
    """The migrations of this version of the software, whose files are read once: readiness is asked for often."""
    return frozenset(script.revision for script in _scripts(_config()).walk_revisions())


@cache
def _own_heads() -> frozenset[str]:
    """Where the tables of this version of the software are."""
    return frozenset(_scripts(_config()).get_heads())


def _make_private(file: Path) -> None:
    """Make an embedded database's file, which holds customers' captures, for this user alone; one there is left."""
    with suppress(OSError):  # one that is there, or a place that cannot be written to, which is told when it is opened
        os.close(os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))


def _config() -> Config:
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", "services.db:migrations")
    return config


def _scripts(config: Config) -> ScriptDirectory:
    from alembic.script import ScriptDirectory

    return ScriptDirectory.from_config(config)
