"""The queue: one job to one worker, leases, crashes, cancelling. SQLite here, PostgreSQL in `test_jobs_postgres`."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from types import SimpleNamespace
from typing import Any

import pytest
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from sqlalchemy import select, text, update

from services.api.auth import EVERYBODY
from services.api.idempotency import Answer, Once
from services.api.problems import ProblemError
from services.api.submit import submit_job
from services.db.base import utc_now
from services.db.engine import Database
from services.db.idempotency import IdempotencyRecord
from services.db.jobs import Job, JobFile, JobStatus
from services.db.migrate import is_current, is_usable, require_current, upgrade
from services.jobs.files import FileContent
from services.jobs.maintenance import purge
from services.jobs.queue import Claim, JobQueue, enqueue, request_cancel
from services.settings import Settings
from simcore.errors import MissingResourceError
from tests.services.job_rows import read_job

ARCHIVE = FileContent("a.zip", "application/zip", b"content")
REPORT = FileContent("report.html", "text/html", b"<p>")


class Asked(BaseModel):
    """What a job is asked."""

    n: int = 1


class AskedLater(Asked):
    """The same in a later version, which can be asked for more."""

    sensor: str = "ideal"


@pytest.fixture
def queue(database: Database) -> JobQueue:
    return JobQueue(database, lease_s=30, max_attempts=2)


def fall_silent(database: Database) -> None:
    """Let all leases run out."""
    with database.write() as session:
        session.execute(update(Job).values(lease_expires_at=utc_now() - timedelta(seconds=1)))


def add(database: Database, *, kind: str = "drape_distance") -> str:
    with database.write() as session:
        return enqueue(session, kind, {"n": 1}, files=[ARCHIVE]).id


def files(database: Database, role: str) -> list[str]:
    with database.read() as session:
        return list(session.scalars(select(JobFile.name).where(JobFile.role == role)))


def claimed(queue: JobQueue, worker: str = "w") -> Claim:
    claim = queue.claim(worker)
    assert claim is not None
    return claim


def test_jobs_come_in_order_with_their_files(database: Database, queue: JobQueue) -> None:
    first, second = add(database), add(database)
    one, two = claimed(queue), claimed(queue, "other")
    assert (one.id, two.id) == (first, second)
    assert one.files == (ARCHIVE,)
    assert queue.claim("w") is None


def test_jobs_that_cannot_be_done_now_come_after_all_others(database: Database, queue: JobQueue) -> None:
    first, second, third = add(database), add(database), add(database)
    taken = [queue.claim("w", last={first, third}) for _ in range(3)]
    assert [claim and claim.id for claim in taken] == [second, first, third]


def test_no_job_goes_to_two_workers(database: Database, queue: JobQueue) -> None:
    ids = {add(database) for _ in range(30)}

    def drain(worker: str) -> list[str]:
        found = []
        while (claim := queue.claim(worker)) is not None:
            found.append(claim.id)
        return found

    with ThreadPoolExecutor(6) as pool:
        taken = [job for jobs in pool.map(drain, "abcdef") for job in jobs]
    assert len(taken) == 30
    assert set(taken) == ids


def test_a_result_is_stored_and_inputs_are_dropped(database: Database, queue: JobQueue) -> None:
    job_id = add(database)
    assert queue.succeed(claimed(queue), {"distance": 0.5}, [REPORT])
    job = read_job(database, job_id)
    assert (job.status, job.result, job.progress, job.worker) == ("succeeded", {"distance": 0.5}, 1.0, None)
    assert (files(database, "input"), files(database, "output")) == ([], ["report.html"])


def test_a_silent_workers_job_is_given_to_another_and_its_late_result_dropped(
    database: Database, queue: JobQueue
) -> None:
    job_id = add(database)
    silent = claimed(queue, "silent")
    assert queue.reap() == 0
    fall_silent(database)
    assert queue.reap() == 1
    second = claimed(queue, "second")
    assert (second.id, second.attempt) == (job_id, 2)
    assert queue.renew(silent) is None
    assert not queue.succeed(silent, {"distance": 1.0})
    assert queue.succeed(second, {"distance": 2.0})
    assert read_job(database, job_id).result == {"distance": 2.0}


def test_a_lease_from_before_the_clock_was_set_back_does_not_outlive_its_worker(
    database: Database, queue: JobQueue
) -> None:
    job_id = add(database)
    claimed(queue, "dead")
    with database.write() as session:
        session.execute(update(Job).values(lease_expires_at=utc_now() + timedelta(hours=1)))
    assert queue.reap() == 1
    assert claimed(queue, "next").id == job_id


def test_a_job_that_kills_its_workers_is_given_up(database: Database, queue: JobQueue) -> None:
    job_id = add(database)
    for _ in range(2):
        claimed(queue)
        fall_silent(database)
        queue.reap()
    job = read_job(database, job_id)
    assert job.status == JobStatus.FAILED
    assert job.problem is not None
    assert job.problem["code"] == "job_crashed"
    assert queue.claim("w") is None


def test_renewing_keeps_the_lease_and_tells_of_cancelling(database: Database, queue: JobQueue) -> None:
    job_id = add(database)
    claim = claimed(queue)
    fall_silent(database)
    assert queue.renew(claim, progress=0.25, message="still at it") is True
    assert queue.reap() == 0
    assert (read_job(database, job_id).progress, read_job(database, job_id).message) == (0.25, "still at it")
    with database.write() as session:
        request_cancel(session, session.scalars(select(Job)).one())
    assert queue.renew(claim) is False
    assert queue.cancel(claim)
    assert read_job(database, job_id).status == JobStatus.CANCELLED


def test_a_job_given_back_in_good_order_does_not_lose_an_attempt(database: Database, queue: JobQueue) -> None:
    add(database)
    for _ in range(5):
        claim = claimed(queue)
        assert claim.attempt == 1
        assert queue.release(claim, count_attempt=False)
    first = claimed(queue)
    assert queue.release(first, count_attempt=True)
    assert claimed(queue).attempt == 2


def test_a_cancelled_job_of_a_silent_worker_is_not_run_again(database: Database, queue: JobQueue) -> None:
    job_id = add(database)
    claimed(queue)
    with database.write() as session:
        request_cancel(session, session.scalars(select(Job)).one())
    fall_silent(database)
    queue.reap()
    assert read_job(database, job_id).status == JobStatus.CANCELLED


@pytest.mark.parametrize("count_attempt", [True, False])
def test_a_cancelled_job_that_is_given_back_is_not_run_again(
    database: Database, queue: JobQueue, count_attempt: bool
) -> None:
    """Neither does it fail where this was the last attempt."""
    job_id = add(database)
    for _ in range(queue._max_attempts - 1):
        assert queue.release(claimed(queue), count_attempt=True)
    claim = claimed(queue)
    with database.write() as session:
        request_cancel(session, session.scalars(select(Job)).one())
    assert queue.release(claim, count_attempt=count_attempt)
    assert read_job(database, job_id).status == JobStatus.CANCELLED
    assert queue.claim("w") is None and not queue.release(claim, count_attempt=count_attempt)


def test_an_option_of_a_later_version_leaves_a_request_the_same(database: Database) -> None:
    state: Any = SimpleNamespace(database=database, settings=Settings())

    def submit(inputs: BaseModel) -> JSONResponse:
        return submit_job(state, EVERYBODY, "once", "drape_distance", inputs)

    first, again = submit(Asked(n=2)), submit(AskedLater(n=2, sensor="ideal"))
    assert first.headers["location"] == again.headers["location"]
    with pytest.raises(ProblemError) as caught:
        submit(AskedLater(n=2, sensor="sr300"))
    assert caught.value.code == "idempotency_key_reused"


def test_no_more_jobs_wait_than_may(database: Database, queue: JobQueue) -> None:
    state = SimpleNamespace(database=database, settings=Settings(job_queue=2))

    def submit() -> JSONResponse:
        return submit_job(state, EVERYBODY, None, "drape_distance", Asked())  # type: ignore[arg-type]  # all it reads

    assert [submit().status_code for _ in range(2)] == [202, 202]
    with pytest.raises(ProblemError, match="2 jobs are waiting already: try again") as caught:
        submit()
    assert (caught.value.status_code, caught.value.code) == (429, "jobs_saturated")
    assert caught.value.headers == {"Retry-After": "60"}
    with database.read() as session:
        assert len(session.scalars(select(Job)).all()) == 2
    claimed(queue)
    assert submit().status_code == 202


def test_a_waiting_job_is_cancelled_at_once(database: Database, queue: JobQueue) -> None:
    job_id = add(database)
    with database.write() as session:
        request_cancel(session, session.scalars(select(Job)).one())
    assert read_job(database, job_id).status == JobStatus.CANCELLED
    assert queue.claim("w") is None
    assert files(database, "input") == []


def test_old_jobs_and_answers_are_forgotten(database: Database, queue: JobQueue) -> None:
    old, kept = add(database), add(database)
    queue.succeed(claimed(queue), {}, [REPORT])
    queue.succeed(claimed(queue), {}, [REPORT])
    long_ago = utc_now() - timedelta(days=40)
    with database.write() as session:
        session.execute(update(Job).where(Job.id == old).values(finished_at=long_ago))
        for key, created in (("old", long_ago), ("new", utc_now())):
            session.add(
                IdempotencyRecord(
                    caller="", key=key, fingerprint="f", status=200, headers={}, body={}, created_at=created
                )
            )
    purge(database, jobs_after_days=30, answers_after_hours=24)
    with database.read() as session:
        assert list(session.scalars(select(Job.id))) == [kept]
        assert list(session.scalars(select(IdempotencyRecord.key))) == ["new"]
    assert files(database, "output") == ["report.html"]


def test_an_answer_is_remembered_for_its_time_and_no_longer(database: Database) -> None:
    once = Once(database, EVERYBODY, "key", "fingerprint", hours=1.0)
    made: list[int] = []

    def answer(session: Any) -> Answer:
        made.append(len(made))
        return Answer(200, {"made": made[-1]})

    def given(response: Any) -> Any:
        return json.loads(response.body)["made"]

    assert [given(once.answer(answer)) for _ in range(2)] == [0, 0]
    with database.write() as session:
        session.execute(update(IdempotencyRecord).values(created_at=utc_now() - timedelta(hours=2)))
    assert once.earlier() is None
    assert [given(once.answer(answer)) for _ in range(2)] == [1, 1]


def test_tables_of_a_later_version_are_served_from_and_not_started_with(database: Database) -> None:
    assert is_usable(database) and is_current(database)
    require_current(database)
    with database.engine.execution_options(write=True).begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = 'of_next_year'"))
    assert is_usable(database) and not is_current(database)
    for begin in (require_current, upgrade):
        with pytest.raises(MissingResourceError, match=r"test\.db are of a later version: start that") as caught:
            begin(database)
        assert caught.value.code == "database_later_version"
    with database.engine.execution_options(write=True).begin() as connection:
        connection.execute(text("DELETE FROM alembic_version"))
    assert not is_usable(database)
    with pytest.raises(MissingResourceError, match=r"test\.db are of another version: run .*serve --migrate") as caught:
        require_current(database)
    assert caught.value.code == "database_not_migrated"
