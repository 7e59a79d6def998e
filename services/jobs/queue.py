"""The durable queue: jobs in the database, taken under a lease that a living worker renews."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from sqlalchemy import ColumnElement, CursorResult, and_, delete, or_, select, update
from sqlalchemy.orm import Session, undefer

from services.db.base import utc_now
from services.db.engine import Database
from services.db.jobs import Job, JobFile, JobStatus, Worker
from services.jobs.files import FileContent

LEASES_AHEAD = 10
"""A lease that ends so many leases from now is of another time; workers' settings may differ by less."""


@dataclass(frozen=True)
class Claim:
    """A job that this worker may run; ``attempt`` fences off a worker that lost its lease."""

    number: int
    id: str
    kind: str
    inputs: dict[str, Any]
    files: tuple[FileContent, ...]
    attempt: int
    worker: str


def enqueue(
    session: Session, kind: str, inputs: dict[str, Any], *, files: Sequence[FileContent] = (), owner: str | None = None
) -> Job:
    """Add a job in the caller's transaction."""
    job = Job(kind=kind, inputs=inputs, owner=owner, attempts=0, progress=0.0, message="", cancel_requested=False)
    session.add(job)
    session.flush()
    _add_files(session, job.number, "input", files)
    return job


def request_cancel(session: Session, job: Job) -> None:
    """Cancel a waiting job at once, a running one as soon as its worker looks; a finished one stays as it is."""
    # Conditional on the status in the database: a worker may take the job between our reading and our writing, and
    # (on PostgreSQL, where the row is held) may give it back between the two writings.
    session.execute(select(Job.number).where(Job.number == job.number).with_for_update())
    waiting = update(Job).where(Job.number == job.number, Job.status == JobStatus.QUEUED)
    session.execute(waiting.values(status=JobStatus.CANCELLED, finished_at=utc_now()))
    running = update(Job).where(Job.number == job.number, Job.status == JobStatus.RUNNING)
    session.execute(running.values(cancel_requested=True))
    session.refresh(job)
    if job.status == JobStatus.CANCELLED:
        _drop_inputs(session, job.number)


class JobQueue:
    """What a worker does with the queue.

    Args:
        database: where the jobs are.
        lease_s: how long a silent worker is believed to be alive.
        max_attempts: how often a job is begun before it is given up.
    """

    def __init__(self, database: Database, *, lease_s: float, max_attempts: int) -> None:
        self._database = database
        self._lease = timedelta(seconds=lease_s)
        self._max_attempts = max_attempts

    def beat(self, worker: str) -> None:
        """Say that a worker is alive."""
        now = self._database.now
        with self._database.write() as session:
            if not _rows(session, update(Worker).where(Worker.id == worker).values(seen_at=now)):
                session.add(Worker(id=worker, started_at=now, seen_at=now))

    def leave(self, worker: str) -> None:
        """Forget a worker that ends in good order."""
        with self._database.write() as session:
            session.execute(delete(Worker).where(Worker.id == worker))

    def claim(self, worker: str, last: Collection[str] = ()) -> Claim | None:
        """Take the oldest waiting job, or nothing; two workers never get the same.

        Args:
            worker: who takes it.
            last: jobs, by id, that are taken only if no other waits.
        """
        with self._database.read() as session:  # an idle worker takes no lock
            if session.scalar(select(Job.number).where(Job.status == JobStatus.QUEUED).limit(1)) is None:
                return None
        now = self._database.now
        # PostgreSQL skips rows that others are about to take; SQLite has one writer at a time.
        oldest = (
            select(Job.number)
            .where(Job.status == JobStatus.QUEUED)
            .order_by(Job.id.in_(last), Job.number)
            .limit(1)
            .with_for_update(skip_locked=True)
            .scalar_subquery()
        )
        taking = (
            update(Job)
            .where(Job.number == oldest, Job.status == JobStatus.QUEUED)
            .values(
                status=JobStatus.RUNNING,
                worker=worker,
                attempts=Job.attempts + 1,
                lease_expires_at=now + self._lease,
                started_at=now,
                progress=0.0,
                message="",
            )
            .returning(Job)
        )
        with self._database.write() as session:
            job = session.scalars(taking, execution_options={"synchronize_session": False}).one_or_none()
            if job is None:
                return None
            files = session.scalars(
                select(JobFile)
                .where(JobFile.job_number == job.number, JobFile.role == "input")
                .options(undefer(JobFile.content))
            )
            contents = tuple(FileContent(f.name, f.media_type, f.content) for f in files)
            return Claim(job.number, job.id, job.kind, job.inputs, contents, job.attempts, worker)

    def unfinished(self, jobs: Collection[str]) -> frozenset[str]:
        """Those of some jobs, by id, that wait or run."""
        going_on = Job.status.in_([JobStatus.QUEUED, JobStatus.RUNNING])
        with self._database.read() as session:
            return frozenset(session.scalars(select(Job.id).where(Job.id.in_(list(jobs)), going_on)))

    def renew(self, claim: Claim, *, progress: float | None = None, message: str | None = None) -> bool | None:
        """Prolong the lease and note progress.

        Returns:
            True to go on, False when the job is to be cancelled, None when the lease is lost.
        """
        changes: dict[str, Any] = {"lease_expires_at": self._database.now + self._lease}
        if progress is not None:
            changes["progress"] = min(1.0, max(0.0, progress))
        if message is not None:
            changes["message"] = message[:200]
        with self._database.write() as session:
            if not _rows(session, update(Job).where(_held(claim)).values(**changes)):
                return None
            return not session.scalar(select(Job.cancel_requested).where(Job.number == claim.number))

    def succeed(self, claim: Claim, result: dict[str, Any], files: Sequence[FileContent] = ()) -> bool:
        """Store the result; False when the lease was lost and the result is dropped."""
        return self._end(claim, files, status=JobStatus.SUCCEEDED, result=result, progress=1.0, message="")

    def fail(self, claim: Claim, code: str, detail: str) -> bool:
        """The job cannot be done."""
        return self._end(claim, (), status=JobStatus.FAILED, problem={"code": code, "detail": detail})

    def cancel(self, claim: Claim) -> bool:
        """The job was stopped on request."""
        return self._end(claim, (), status=JobStatus.CANCELLED)

    def release(self, claim: Claim, *, count_attempt: bool, message: str = "") -> bool:
        """Give an unfinished job back; it is run again from the start, or cancelled where that was asked for.

        Args:
            count_attempt: False for an orderly shutdown and its like, which are no fault of the job.
            message: why it waits again.
        """
        if self._end(claim, (), if_asked=True, status=JobStatus.CANCELLED):
            return True
        if count_attempt and claim.attempt >= self._max_attempts:
            return self.fail(claim, "job_crashed", self._gave_up())
        with self._database.write() as session:
            giving_back = update(Job).where(_held(claim), Job.cancel_requested.is_(False))
            attempts = claim.attempt if count_attempt else claim.attempt - 1
            waits = giving_back.values(**_WAITING_AGAIN, attempts=attempts, message=message[:200])
            if _rows(session, waits):
                return True
        return self.cancel(claim)  # asked for in between, or not held any more

    def reap(self) -> int:
        """Take jobs from workers that fell silent; returns how many."""
        now = self._database.now
        over = Job.lease_expires_at < now
        if self._database.is_sqlite:  # by this machine's clock, which may have been set back since
            over = or_(over, Job.lease_expires_at > now + LEASES_AHEAD * self._lease)
        silent = and_(Job.status == JobStatus.RUNNING, over)
        ended = {"finished_at": now, "worker": None, "lease_expires_at": None}
        problem = {"code": "job_crashed", "detail": self._gave_up()}
        with self._database.write() as session:
            cancelled = update(Job).where(silent, Job.cancel_requested)
            count = _rows(session, cancelled.values(status=JobStatus.CANCELLED, **ended))
            hopeless = update(Job).where(silent, Job.attempts >= self._max_attempts)
            count += _rows(session, hopeless.values(status=JobStatus.FAILED, problem=problem, **ended))
            count += _rows(session, update(Job).where(silent).values(**_WAITING_AGAIN))
            session.execute(delete(Worker).where(Worker.seen_at < now - 10 * self._lease))
        return count

    def _end(self, claim: Claim, files: Sequence[FileContent], *, if_asked: bool = False, **changes: Any) -> bool:
        """End a job that is held; with ``if_asked`` only where it is to be cancelled."""
        held = and_(_held(claim), Job.cancel_requested) if if_asked else _held(claim)
        ended = {"finished_at": self._database.now, "worker": None, "lease_expires_at": None, **changes}
        with self._database.write() as session:
            if not _rows(session, update(Job).where(held).values(**ended)):
                return False
            _drop_inputs(session, claim.number)
            _add_files(session, claim.number, "output", files)
        return True

    def _gave_up(self) -> str:
        return f"the process that ran the job ended unexpectedly {self._max_attempts} times; see the worker's log"


_WAITING_AGAIN = {"status": JobStatus.QUEUED, "worker": None, "lease_expires_at": None, "progress": 0.0}


def _held(claim: Claim) -> ColumnElement[bool]:
    return and_(
        Job.number == claim.number,
        Job.status == JobStatus.RUNNING,
        Job.worker == claim.worker,
        Job.attempts == claim.attempt,
    )


def _rows(session: Session, statement: Any) -> int:
    outcome = session.execute(statement, execution_options={"synchronize_session": False})
    return outcome.rowcount if isinstance(outcome, CursorResult) else 0


def _add_files(session: Session, job_number: int, role: str, files: Sequence[FileContent]) -> None:
    for file in files:
        session.add(
            JobFile(job_number=job_number, role=role, name=file.name, media_type=file.media_type, content=file.content)
        )


def _drop_inputs(session: Session, job_number: int) -> None:
    session.execute(delete(JobFile).where(JobFile.job_number == job_number, JobFile.role == "input"))
