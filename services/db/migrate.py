"""Bringing the tables up to date with alembic; the migrations are part of the package."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simcore.errors import MissingResourceError

if TYPE_CHECKING:
    from alembic.config import Config
    from alembic.script import ScriptDirectory

    from services.db.engine import Database

MIGRATION_LOCK = 0x64726170656D
"""Advisory lock that keeps two servers from migrating PostgreSQL at once (the letters 'drapem')."""


def upgrade(database: Database) -> None:
    """Run the missing migrations; several processes may call this at once.

    Raises:
        MissingResourceError: the database cannot be reached.
    """
    from alembic import command
    from sqlalchemy import text

    database.ping()
    config = _config()
    with database.engine.execution_options(write=True).begin() as connection:
        if not database.is_sqlite:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": MIGRATION_LOCK})
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


def is_current(database: Database) -> bool:
    """Whether the tables are those of this version of the software."""
    from alembic.migration import MigrationContext

    with database.engine.connect() as connection:
        heads = MigrationContext.configure(connection).get_current_heads()
    return set(heads) == set(_scripts(_config()).get_heads())


def require_current(database: Database) -> None:
    """Check before serving.

    Raises:
        MissingResourceError: the database cannot be reached, or its tables are of another version.
    """
    database.ping()
    if not is_current(database):
        raise MissingResourceError(
            f"the tables of {database.public_url} are of another version: run 'drapemeter serve --migrate' first",
            code="database_not_migrated",
        )


def _config() -> Config:
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", "services.db:migrations")
    return config


def _scripts(config: Config) -> ScriptDirectory:
    from alembic.script import ScriptDirectory

    return ScriptDirectory.from_config(config)
