"""The worker: what it does while a cluster, the database or its machine is not there."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from sqlalchemy import select
from sqlalchemy.exc import DataError, OperationalError

from services.db.engine import Database
from services.db.jobs import Job, JobStatus
from services.jobs.queue import JobQueue, enqueue, request_cancel
from services.jobs.scratch import make_scratch
from services.jobs.task import Call, Done, Event, Progress, Refused, Runner, TaskOutput
from services.jobs.worker import JobWorker
from services.settings import Settings
from tests.services.job_rows import read_job


def add(database: Database, kind: str = "drape_distance") -> str:
    with database.write() as session:
        return enqueue(session, kind, {"n": 1}).id


class Working(Runner):
    """Works for some polls, then is done."""

    def __init__(self, polls: int) -> None:
        self.left, self.stops = polls, 0

    def start(self, call: Call) -> None:
        """Nothing to do."""

    def poll(self, timeout_s: float) -> Event | None:
        time.sleep(0.02)
        self.left -= 1
        return None if self.left > 0 else Done(TaskOutput({"distance": 0.5}, ()))

    def stop(self) -> None:
        self.stops += 1


class Refusing(Working):
    """Has no cluster at first."""

    def __init__(self, *answers: Event) -> None:
        super().__init__(0)
        self.answers = list(answers)

    def poll(self, timeout_s: float) -> Event | None:
        return self.answers.pop(0)


AWAY = Refused("cluster_missing", "no Ray cluster answers at head:6379", True)


def worked(database: Database, job_id: str, runner: Runner, **settings: float) -> Job:
    """A job after a worker has had it for as long as it wants."""
    stopping = threading.Event()
    made = Settings.model_validate({"database": str(database.url), "job_lease_s": 5.0, **settings})
    worker = JobWorker(made, database, runner, stopping)
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(worker.run)
        deadline = time.monotonic() + 30
        while read_job(database, job_id).finished_at is None and time.monotonic() < deadline:
            time.sleep(0.05)
        stopping.set()
        running.result()
    return read_job(database, job_id)


def test_a_job_waits_for_a_cluster_that_is_away(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.jobs.worker.PAUSE_S", 0.05)
    done = Done(TaskOutput({"distance": 0.5}, ()))
    job = worked(database, add(database), Refusing(AWAY, AWAY, AWAY, AWAY, done))
    assert (job.status, job.attempts, job.result) == (JobStatus.SUCCEEDED, 1, {"distance": 0.5})
    job = worked(database, add(database), Refusing(AWAY), job_cluster_patience_s=0.0)
    assert job.status == JobStatus.FAILED and job.problem is not None and job.problem["code"] == "cluster_missing"


def test_jobs_that_wait_for_a_cluster_let_others_pass(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.jobs.worker.PAUSE_S", 0.05)
    waiting, other = [add(database), add(database)], add(database, kind="diagnosis")
    done = Done(TaskOutput({"distance": 0.5}, ()))
    last = worked(database, waiting[1], Refusing(AWAY, AWAY, done, AWAY, done, done))
    jobs = [read_job(database, job) for job in (*waiting, other)]
    assert all(job.status == JobStatus.SUCCEEDED for job in jobs)
    ended = [job.finished_at for job in (jobs[2], jobs[0], last)]
    assert ended == sorted(ended, key=lambda at: str(at))


@pytest.mark.parametrize("code", ["store_no_space", "store_unreachable", "no_room"])
def test_a_job_waits_for_room_on_a_full_disk_and_not_for_ever(
    code: str, database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.jobs.worker.PAUSE_S", 0.05)
    full, done = Refused(code, "no space is left; make room", False), Done(TaskOutput({"rows": 3}, ()))
    job = worked(database, add(database), Refusing(full, full, full, full, done))
    assert (job.status, job.attempts, job.result) == (JobStatus.SUCCEEDED, 1, {"rows": 3})
    job = worked(database, add(database), Refusing(full), job_cluster_patience_s=0.0)
    assert job.status == JobStatus.FAILED and job.problem is not None and job.problem["code"] == code


class Clock:
    """One that a runner sets forward."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = time.monotonic()
        stands = SimpleNamespace(monotonic=lambda: self.now, sleep=time.sleep, time=time.time, time_ns=time.time_ns)
        monkeypatch.setattr("services.jobs.worker.time", stands)
        monkeypatch.setattr("services.jobs.worker.PAUSE_S", 0.01)


class Slow(Refusing):
    """The same, a hundred seconds from one answer to the next."""

    def __init__(self, clock: Clock, *answers: Event) -> None:
        super().__init__(*answers)
        self.clock = clock

    def poll(self, timeout_s: float) -> Event | None:
        self.clock.now += 100.0
        return super().poll(timeout_s)


def test_a_job_waits_as_long_again_for_a_cluster_that_was_there_in_between(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = Done(TaskOutput({"distance": 0.5}, ()))
    work = [Progress(done / 10) for done in range(1, 10)]
    job = worked(database, add(database), Slow(Clock(monkeypatch), AWAY, *work, AWAY, AWAY, done))
    assert (job.status, job.attempts) == (JobStatus.SUCCEEDED, 1)


def test_what_was_kept_of_a_job_is_no_sign_of_the_cluster(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each attempt comes as far as what is kept goes, and no further."""
    again: list[Event] = [Progress(0.1), Progress(0.2), AWAY]
    job = worked(database, add(database), Slow(Clock(monkeypatch), *again, *again, *again, *again))
    assert job.problem is not None and job.problem["code"] == "cluster_missing"


def test_a_job_that_ends_while_it_waits_for_its_cluster_is_forgotten(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.jobs.worker.PAUSE_S", 0.0)
    first, second = add(database), add(database)
    settings = Settings(database=str(database.url))
    worker = JobWorker(settings, database, Refusing(AWAY, AWAY), threading.Event())

    def refused() -> str:
        claim = JobQueue(database, lease_s=30, max_attempts=2).claim(worker.name)
        assert claim is not None
        worker.work(claim)
        return claim.id

    assert refused() == first
    with database.write() as session:
        request_cancel(session, session.scalars(select(Job).where(Job.id == first)).one())
    assert refused() == second
    worker._keep_house()
    assert set(worker._waiting) == {second}


def test_what_this_machine_lacks_costs_no_attempt(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.jobs.worker.PAUSE_S", 0.05)
    full = iter([OSError(28, "No space left on device"), OSError(28, "No space left on device")])

    def make() -> Path:
        for error in full:
            raise error
        return make_scratch()

    monkeypatch.setattr("services.jobs.worker.make_scratch", make)
    job = worked(database, add(database), Working(2))
    assert (job.status, job.attempts) == (JobStatus.SUCCEEDED, 1)


def test_a_job_waits_for_room_however_long_and_says_what_would_make_it(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.jobs.worker.PAUSE_S", 0.0)

    def full() -> Path:
        raise OSError(28, "No space left on device", "/tmp/drapemeter-scratch-x")

    monkeypatch.setattr("services.jobs.worker.make_scratch", full)
    settings = Settings(database=str(database.url), job_cluster_patience_s=0.0)
    worker, job_id = JobWorker(settings, database, Working(1), threading.Event()), add(database)
    for _ in range(2):
        claim = JobQueue(database, lease_s=30, max_attempts=1).claim(worker.name)
        assert claim is not None
        worker.work(claim)
    job = read_job(database, job_id)
    assert (job.status, job.attempts) == (JobStatus.QUEUED, 0)
    assert "No space left" in job.message and job.message.endswith("make room in TMPDIR, or name another folder in it")


def test_a_job_outlives_a_database_that_is_away_for_longer_than_its_lease(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, refused = JobQueue.renew, []

    def after_a_while(self: JobQueue, *given: Any, **more: Any) -> Any:
        if not refused or refused[-1] - refused[0] < 1.0:
            refused.append(time.monotonic())
            raise OperationalError("UPDATE", {}, Exception("the server closed the connection"))
        return whole(self, *given, **more)

    monkeypatch.setattr(JobQueue, "renew", after_a_while)
    runner = Working(100)
    job = worked(database, add(database), runner, job_lease_s=0.5)
    assert (job.status, job.attempts) == (JobStatus.SUCCEEDED, 1)
    assert refused[-1] - refused[0] > 0.5  # longer than the lease
    assert runner.left <= 0  # it was never begun again


def test_a_worker_that_starts_takes_no_job_from_the_living(database: Database) -> None:
    """It may be started because the database is back, before those who live have renewed their leases."""
    add(database)
    queue = JobQueue(database, lease_s=0.1, max_attempts=3)
    claim = queue.claim("alive")
    assert claim is not None
    time.sleep(0.3)
    stopping = threading.Event()
    worker = JobWorker(Settings(database=str(database.url), job_lease_s=5.0), database, Working(0), stopping)
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(worker.run)
        time.sleep(1.0)
        stopping.set()
        running.result()
    assert queue.renew(claim) is True


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_no_job_is_taken_from_the_living_when_the_clock_is_set(
    database: Database, monkeypatch: pytest.MonkeyPatch, step_s: float
) -> None:
    """Nor when the machine wakes: those who live renew their leases, but not at once."""
    add(database)
    queue = JobQueue(database, lease_s=20, max_attempts=3)
    claim = queue.claim("alive")
    assert claim is not None
    worker = JobWorker(Settings(database=str(database.url)), database, Working(0), threading.Event())
    worker._keep_house()
    whole = time.time
    monkeypatch.setattr(time, "time", lambda: whole() + step_s)
    monkeypatch.setattr("services.db.engine.utc_now", lambda: datetime.now(UTC) + timedelta(seconds=step_s))
    worker._last_beat = float("-inf")
    worker._keep_house()
    assert queue.renew(claim) is True
    worker._last_beat = worker._reaps_from = float("-inf")
    worker._keep_house()
    assert queue.succeed(claim, {})


def test_a_result_that_the_database_does_not_take_fails_its_job(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: JobQueue, *given: Any, **more: Any) -> bool:
        raise DataError("UPDATE", {}, Exception("unsupported Unicode escape sequence"))

    monkeypatch.setattr(JobQueue, "succeed", refuse)
    job = worked(database, add(database), Working(2))
    assert job.status == JobStatus.FAILED and job.attempts == 1
    assert job.problem is not None and job.problem["code"] == "internal_error"


@pytest.mark.parametrize("name", ["renew", "beat", "succeed", "claim"])
def test_a_database_that_is_away_for_a_moment_costs_no_job(
    database: Database, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    job_id, stopping, faults = add(database), threading.Event(), []
    whole = getattr(JobQueue, name)

    def sometimes(self: JobQueue, *given: Any, **more: Any) -> Any:
        if len(faults) < 2:
            faults.append(name)
            raise OperationalError("UPDATE", {}, Exception("the server closed the connection"))
        return whole(self, *given, **more)

    monkeypatch.setattr(JobQueue, name, sometimes)
    settings = Settings.model_validate({"database": str(database.url), "job_lease_s": 5.0})
    runner = Working(120)
    worker = JobWorker(settings, database, runner, stopping)
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(worker.run)
        deadline = time.monotonic() + 30
        while read_job(database, job_id).status != JobStatus.SUCCEEDED and time.monotonic() < deadline:
            time.sleep(0.05)
        stopping.set()
        running.result()
    job = read_job(database, job_id)
    assert (job.status, job.attempts, len(faults)) == (JobStatus.SUCCEEDED, 1, 2)
