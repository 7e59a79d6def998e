"""The same on a real PostgreSQL: migrations, the queue under contention, and the whole service."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import select, text, update

from services.db.base import utc_now
from services.db.engine import Database, in_turn
from services.db.jobs import Job
from services.db.migrate import is_current, is_usable, require_current, upgrade
from services.db.models import Base
from services.jobs.files import FileContent
from services.jobs.queue import JobQueue, enqueue, request_cancel
from simcore.errors import MissingResourceError
from tests.services.postgres import postgres
from tests.services.served import QUICK, STIFF, drapemeter, serving

pytestmark = pytest.mark.postgres


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    with postgres() as url:
        yield url


@pytest.fixture
def database(cluster: str) -> Iterator[Database]:
    """Tables made anew for each test."""
    opened = Database(cluster)
    with opened.engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    yield opened
    opened.close()


def add(database: Database, count: int) -> set[str]:
    with database.write() as session:
        return {enqueue(session, "dataset", {}, files=[FileContent("a", "b/c", b"x")]).id for _ in range(count)}


def test_migrations_make_the_tables_of_the_models_also_when_run_at_once(database: Database) -> None:
    assert not is_current(database)
    with ThreadPoolExecutor(3) as pool:
        list(pool.map(lambda _: upgrade(database), range(3)))
    assert is_current(database)
    with database.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []


def test_tables_of_a_later_version_are_not_started_with(database: Database) -> None:
    upgrade(database)
    with database.engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = 'of_next_year'"))
    assert is_usable(database) and not is_current(database)
    for begin in (require_current, upgrade):
        with pytest.raises(MissingResourceError, match="are of a later version: start that") as caught:
            begin(database)
        assert caught.value.code == "database_later_version"


def test_no_job_goes_to_two_workers(database: Database) -> None:
    upgrade(database)
    ids = add(database, 60)
    queue = JobQueue(database, lease_s=30, max_attempts=3)

    def drain(worker: str) -> list[str]:
        found = []
        while (claim := queue.claim(worker)) is not None:
            found.append(claim.id)
        return found

    with ThreadPoolExecutor(6) as pool:
        taken = [job for jobs in pool.map(drain, "abcdef") for job in jobs]
    assert len(taken) == 60
    assert set(taken) == ids


def test_a_row_held_by_another_is_skipped(database: Database) -> None:
    upgrade(database)
    add(database, 2)
    queue = JobQueue(database, lease_s=30, max_attempts=3)
    with database.write() as session:
        held = session.scalars(select(Job).order_by(Job.number).limit(1).with_for_update()).one()
        claim = queue.claim("w")  # does not wait for the lock
        assert claim is not None
        assert claim.id != held.id


def test_a_worker_whose_clock_is_wrong_takes_no_jobs_from_others(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    upgrade(database)
    add(database, 1)
    queue = JobQueue(database, lease_s=30, max_attempts=3)
    claim = queue.claim("right")
    assert claim is not None
    for module in ("services.db.base", "services.db.engine", "services.jobs.queue"):
        monkeypatch.setattr(f"{module}.utc_now", lambda: datetime.now(UTC) + timedelta(hours=1))
    queue.beat("ahead")
    assert queue.reap() == 0
    assert queue.renew(claim) is True and queue.succeed(claim, {})


def test_what_is_added_in_turn_is_seen_in_the_order_of_its_numbers(database: Database) -> None:
    upgrade(database)
    first_is_in, seen = threading.Event(), []

    def first() -> None:
        with database.write() as session:
            in_turn(session, 1)
            enqueue(session, "dataset", {})
            first_is_in.set()
            time.sleep(0.5)
            seen.append("first")

    def second() -> None:
        first_is_in.wait()
        with database.write() as session:
            in_turn(session, 1)
            enqueue(session, "dataset", {})
            seen.append("second")

    with ThreadPoolExecutor(2) as pool:
        for task in (pool.submit(first), pool.submit(second)):
            task.result()
    assert seen == ["first", "second"]


def test_leases_and_cancelling(database: Database) -> None:
    upgrade(database)
    add(database, 1)
    queue = JobQueue(database, lease_s=30, max_attempts=3)
    silent = queue.claim("silent")
    assert silent is not None and queue.reap() == 0
    with database.write() as session:
        session.execute(update(Job).values(lease_expires_at=utc_now() - timedelta(seconds=1)))
    assert queue.reap() == 1
    second = queue.claim("second")
    assert second is not None
    assert second.attempt == 2
    assert not queue.succeed(silent, {})
    with database.write() as session:
        request_cancel(session, session.scalars(select(Job)).one())
    assert queue.renew(second) is False
    assert queue.cancel(second)


def test_the_service_runs_on_postgresql(cluster: str, database: Database, tmp_path: Path) -> None:
    settings = {"DRAPEMETER_DATABASE": cluster}
    refused = drapemeter(tmp_path, "serve", "--port", "0", **settings)
    assert refused.returncode == 1
    assert "drapemeter serve --migrate" in refused.stderr
    migrated = drapemeter(tmp_path, "serve", "--migrate", "--json", **settings)
    assert migrated.returncode == 0, migrated.stderr
    with serving(tmp_path, "--workers", "0", **settings) as running, running.client() as client:
        assert client.get("/readyz").json()["database"] == "ok"
        headers = {"Idempotency-Key": "at-once"}
        body: dict[str, Any] = {"name": "x", "parameters": STIFF}
        with ThreadPoolExecutor(8) as pool:
            answers = list(pool.map(lambda _: client.post("/v1/fabrics", json=body, headers=headers), range(8)))
        assert {a.status_code for a in answers} == {201}
        assert len({a.json()["id"] for a in answers}) == 1
        body["plm_ref"] = {"system": "windchill", "id": "1", "revision": "A"}
        with ThreadPoolExecutor(8) as pool:
            answers = list(pool.map(lambda _: client.post("/v1/fabrics", json=body), range(8)))
        assert sorted(a.status_code for a in answers) == [201] + 7 * [409]
        assert len(client.get("/v1/fabrics").json()["items"]) == 2
        answer = client.post("/v1/drape-distances", json={"a": STIFF, "b": STIFF, **QUICK})
        assert client.get(answer.headers["location"]).json()["status"] == "queued"
        assert client.delete(answer.headers["location"]).json()["status"] == "cancelled"
        assert 'drapemeter_jobs{kind="drape_distance",status="cancelled"} 1.0' in client.get("/metrics").text
