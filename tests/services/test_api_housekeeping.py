"""A server without workers forgets answers whose time is over."""

from __future__ import annotations

import time
from datetime import timedelta
from typing import Any

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select
from sqlalchemy.exc import OperationalError

from services.api import housekeeping
from services.api.app import create_app
from services.db.base import utc_now
from services.db.engine import Database
from services.db.idempotency import IdempotencyRecord
from services.jobs.maintenance import purge
from services.settings import Settings


def remember(database: Database, key: str, age: timedelta) -> None:
    record = {"caller": "", "key": key, "fingerprint": "f", "status": 200, "headers": {}, "body": {}}
    with database.write() as session:
        session.add(IdempotencyRecord(**record, created_at=utc_now() - age))


def remembered(database: Database) -> list[str]:
    with database.read() as session:
        return list(session.scalars(select(IdempotencyRecord.key)))


def until(found: Any) -> None:
    deadline = time.monotonic() + 30
    while not found():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_old_answers_are_forgotten_without_workers_now_and_then(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(housekeeping, "PURGE_EVERY_S", 0.02)
    remember(database, "new", timedelta(0))
    remember(database, "old", timedelta(hours=25))
    with TestClient(create_app(Settings(database=str(database.url), workers=0))):
        until(lambda: remembered(database) == ["new"])
        remember(database, "older", timedelta(hours=26))
        until(lambda: remembered(database) == ["new"])


def test_a_database_that_is_away_is_asked_again(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def away_at_first(*arguments: Any, **options: Any) -> None:
        asked.append(len(asked))
        if len(asked) < 3:
            raise OperationalError("DELETE", {}, Exception("server closed the connection"))
        purge(*arguments, **options)

    monkeypatch.setattr(housekeeping, "PURGE_EVERY_S", 0.02)
    monkeypatch.setattr(housekeeping, "purge", away_at_first)
    remember(database, "old", timedelta(hours=25))
    with TestClient(create_app(Settings(database=str(database.url), workers=0))):
        until(lambda: not remembered(database))
    ended = len(asked)
    time.sleep(0.1)
    assert len(asked) == ended >= 3
