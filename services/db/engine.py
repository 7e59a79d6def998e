"""Opening the database: one engine a process, short read and write transactions."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from sqlalchemy import ColumnElement, Connection, DateTime, Engine, create_engine, event, func, text
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, InternalError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.orm import Session

from services.db.base import utc_now
from simcore.errors import InputError, MissingResourceError

DATABASE_AWAY = (OperationalError, InternalError, PoolTimeoutError)
"""What is raised where the database does not answer, only reads (a standby), or has no connection left."""
DATABASE_FAILED = (DBAPIError, PoolTimeoutError)
"""Whatever the database or a connection to it raises."""
NO_ROOM_STATE = "53100"
"""PostgreSQL's code of a full disk."""
BUSY_TIMEOUT_S = 30
"""How long a SQLite writer waits for another process's transaction."""
CONNECT_S, ANSWER_S = 5, 15
"""How long a database server may take for a connection, and for a sign of life on one [s]."""
KEPT_CONNECTIONS, MOST_CONNECTIONS = 10, 45
"""To a database server; at most one for each of the 40 threads of our server, and a few."""


def is_full(error: BaseException) -> bool:
    """Whether a database failed for want of room on its disk."""
    cause = getattr(error, "orig", None)
    full = getattr(cause, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
    return full or getattr(cause, "sqlstate", None) == NO_ROOM_STATE


def parse_url(text_url: str) -> URL:
    """A database URL with our driver in it.

    ``postgres://`` and ``postgresql://`` take psycopg; a SQLite URL must name a file, as several processes share it.

    Raises:
        InputError: no such form, or a database that this project does not run on.
    """
    try:
        url = make_url(text_url)
    except (ArgumentError, ValueError):
        raise InputError(
            "the database URL cannot be read: give sqlite:///drapemeter.db or postgresql://user:password@host/name",
            code="database_url",
        ) from None
    if url.drivername in {"postgres", "postgresql"}:
        url = url.set(drivername="postgresql+psycopg")
    if url.drivername not in {"sqlite", "sqlite+pysqlite", "postgresql+psycopg"}:
        raise InputError(
            f"database {url.drivername!r} is not supported: use SQLite (sqlite:///...) or PostgreSQL (postgresql://...)",
            code="database_url",
        )
    if "@" in (url.host or ""):
        raise InputError(
            "the database URL has an @ too many: write one in a password as %40 (and % as %25, / as %2F)",
            code="database_url",
        )
    if url.get_backend_name() == "sqlite" and url.database in {None, "", ":memory:"}:
        raise InputError(
            "an in-memory SQLite database cannot be shared with the job workers: give sqlite:///drapemeter.db",
            code="database_url",
        )
    return url


class Database:
    """A database and its transactions; safe to share between threads, never between processes.

    Attributes:
        url: where it is, password included.
        engine: SQLAlchemy's engine; the tables come by :mod:`services.db.migrate`.
    """

    def __init__(self, url: str) -> None:
        self.url = parse_url(url)
        self.engine = _sqlite_engine(self.url) if self.is_sqlite else _server_engine(self.url)
        self._write_engine = self.engine.execution_options(write=True)

    @property
    def is_sqlite(self) -> bool:
        """Whether this is the embedded default."""
        return self.url.get_backend_name() == "sqlite"

    @property
    def file(self) -> Path | None:
        """Where an embedded database lies; None of a server's."""
        return Path(self.url.database) if self.is_sqlite and self.url.database else None

    @property
    def public_url(self) -> str:
        """For logs: without the password, wherever it stands."""
        return self.url.difference_update_query(["password", "sslpassword"]).render_as_string(hide_password=True)

    @property
    def now(self) -> datetime | ColumnElement[datetime]:
        """The present as those see it who share the database: a server's clock, not that of this machine."""
        return utc_now() if self.is_sqlite else func.clock_timestamp(type_=DateTime(timezone=True))

    @contextmanager
    def read(self) -> Iterator[Session]:
        """A session that only reads; objects stay usable after it."""
        with Session(self.engine, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def write(self) -> Iterator[Session]:
        """A session whose changes are committed at the end, or undone by an exception."""
        with Session(self._write_engine, expire_on_commit=False) as session, session.begin():
            yield session

    def ping(self) -> None:
        """Ask for an answer.

        Raises:
            MissingResourceError: nobody answers.
        """
        try:
            with self.engine.connect() as connection:
                connection.execute(text("SELECT 1"))
        except DBAPIError as error:
            reason = str(error.orig).strip().splitlines()[0] if error.orig else "no reason given"
            raise MissingResourceError(
                f"the database {self.public_url} cannot be reached ({reason}): check that it runs and the URL is right",
                code="database_unreachable",
            ) from None

    def close(self) -> None:
        """Close the pooled connections."""
        self.engine.dispose()


def in_turn(session: Session, key: int) -> None:
    """Let transactions of one kind pass one after the other, so that they are seen in the order of their numbers.

    SQLite has one writer at a time anyway.
    """
    if session.get_bind().dialect.name == "postgresql":
        session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": key})


def _server_engine(url: URL) -> Engine:
    """PostgreSQL: nobody waits for minutes for a machine that is gone; what is stored stays out of error messages."""
    waiting = {"connect_timeout": CONNECT_S, "tcp_user_timeout": 1000 * ANSWER_S, "keepalives_idle": ANSWER_S}
    return create_engine(
        url,
        pool_pre_ping=True,
        pool_size=KEPT_CONNECTIONS,
        max_overflow=MOST_CONNECTIONS - KEPT_CONNECTIONS,
        pool_timeout=CONNECT_S,
        hide_parameters=True,
        connect_args={name: value for name, value in waiting.items() if name not in url.query},
    )


def _sqlite_engine(url: URL) -> Engine:
    """SQLite for several processes: write-ahead log, patience, explicit transactions."""
    engine = create_engine(url, connect_args={"timeout": BUSY_TIMEOUT_S}, hide_parameters=True)

    @event.listens_for(engine, "connect")
    def configure(connection: sqlite3.Connection, _record: Any) -> None:
        connection.isolation_level = None  # the driver begins nothing by itself
        _write_ahead(connection)
        for pragma in ("synchronous=FULL", "foreign_keys=ON"):  # what was answered stays, whatever the power does
            connection.execute(f"PRAGMA {pragma}")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        # A writer takes the lock at once: a read that turns into a write may fail without waiting.
        write = connection.get_execution_options().get("write", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")

    return engine


def _write_ahead(connection: sqlite3.Connection) -> None:
    """Switch to the write-ahead log; of several processes that do so with a new file one is told that it is locked."""
    deadline = time.monotonic() + BUSY_TIMEOUT_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode=WAL")
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > deadline:
                raise
            time.sleep(0.02)
        else:
            return
