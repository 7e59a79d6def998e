"""A worker: takes jobs from the queue and has them done, renewing its lease meanwhile.

It only watches; the work itself is done by a :class:`~services.jobs.task.Runner`, so that the lease is renewed whatever
the work does, and a cancelled job can be stopped at once.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import structlog
from sqlalchemy.exc import OperationalError

from services.db.engine import Database
from services.jobs.execute import execute, gather
from services.jobs.maintenance import purge
from services.jobs.queue import Claim, JobQueue
from services.jobs.scratch import clear_abandoned, make_scratch, remove_scratch
from services.jobs.task import Call, Crashed, Done, Progress, Refused, Resources, Runner, Task, TaskOutput
from services.settings import Settings

POLL_S = 0.3
"""How often the queue is looked at when there is nothing to do, and a job's process when there is."""
PURGE_EVERY_S = 600.0
AWAY_S = 1.0
"""How soon a database that did not answer is asked again."""

log = structlog.get_logger("drapemeter.worker")


class JobWorker:
    """Runs one job at a time.

    Args:
        settings: of the service.
        database: this process's own.
        runner: where the work is done.
        stopping: set from elsewhere to end; the job under way is given back.
        work: does one task, importable in another process.
    """

    def __init__(
        self,
        settings: Settings,
        database: Database,
        runner: Runner,
        stopping: threading.Event,
        work: Callable[..., TaskOutput] = execute,
    ) -> None:
        self.name = f"{socket.gethostname()}-{os.getpid()}-{time.time_ns():x}"
        self._settings = settings
        self._database = database
        self._runner = runner
        self._stopping = stopping
        self._work = work
        self._queue = JobQueue(database, lease_s=settings.job_lease_s, max_attempts=settings.job_attempts)
        self._beat_every_s = min(settings.job_lease_s / 4, 2.0)
        self._last_beat = self._last_purge = float("-inf")

    def run(self) -> None:
        """Until ``stopping`` is set."""
        log.info("worker_started", worker=self.name, abandoned_folders=clear_abandoned())
        try:
            while not self._stopping.is_set():
                try:
                    self._keep_house()
                    claim = self._queue.claim(self.name)
                    if claim is None:
                        self._stopping.wait(POLL_S)
                    else:
                        self.work(claim)
                except OperationalError as error:
                    self._runner.stop()
                    self._say_away(error)
                    self._stopping.wait(AWAY_S)
        finally:
            self._runner.stop()
            with suppress(OperationalError):
                self._queue.leave(self.name)
            log.info("worker_stopped", worker=self.name)

    def work(self, claim: Claim) -> None:
        """Do one job and store how it ended."""
        job_log = log.bind(job=claim.id, kind=claim.kind, attempt=claim.attempt)
        job_log.info("job_started")
        scratch = make_scratch()
        try:
            with self._database.read() as session:
                inputs = gather(session, claim.kind, claim.inputs)
            resources = Resources(self._settings.model, self._settings.dataset_root, self._settings.ray_address)
            task = Task(claim.id, claim.kind, inputs, claim.files, resources, scratch)
            self._runner.start(Call(self._work, (task,)))
            outcome = self._watch(claim)
        finally:
            remove_scratch(scratch)
        job_log.info("job_ended", outcome=outcome)

    def _watch(self, claim: Claim) -> str:
        """Wait for the end of a job; its name for the log."""
        began, next_renewal = time.monotonic(), 0.0
        leased_until = began + self._settings.job_lease_s
        latest = Progress(0.0)
        stop_at: float | None = None
        while True:
            event = self._runner.poll(POLL_S)
            if isinstance(event, Progress):
                latest = event
            elif event is not None:
                return self._settle(claim, event)
            now = time.monotonic()
            if now >= next_renewal:
                next_renewal = now + min(self._beat_every_s, 1.0)
                going_on: bool | None = True
                try:
                    going_on = self._queue.renew(claim, progress=latest.fraction, message=latest.message)
                    leased_until = now + self._settings.job_lease_s
                    self._keep_house()
                except OperationalError as error:
                    self._say_away(error)
                    if now > leased_until:
                        going_on = None  # by now another worker may have the job
                if not going_on:
                    self._runner.stop()
                    return self._abandon(claim, lost=going_on is None)
            if now - began > self._settings.job_time_limit_s:
                self._runner.stop()
                limit = f"{self._settings.job_time_limit_s:g} s"
                self._queue.fail(claim, "job_timed_out", f"the job took more than {limit} and was stopped")
                return "timed_out"
            if self._stopping.is_set():
                stop_at = stop_at if stop_at is not None else now + self._settings.job_shutdown_grace_s
                if now >= stop_at:
                    self._runner.stop()
                    self._queue.release(claim, count_attempt=False)
                    return "given_back"

    def _settle(self, claim: Claim, event: Done | Refused | Crashed) -> str:
        if isinstance(event, Done):
            output: TaskOutput = event.value
            stored = self._insist(lambda: self._queue.succeed(claim, output.result, output.files))
            return "succeeded" if stored else "lease_lost"
        if isinstance(event, Refused):
            self._insist(lambda: self._queue.fail(claim, event.code, event.detail))
            return "failed"
        log.error("job_process_crashed", job=claim.id, reason=event.reason)
        if event.again:
            self._insist(lambda: self._queue.release(claim, count_attempt=True))
            return "crashed"
        unforeseen = "the job failed in a way that nobody foresaw; see the worker's log"
        self._insist(lambda: self._queue.fail(claim, "internal_error", unforeseen))
        return "failed"

    def _insist(self, store: Callable[[], bool]) -> bool:
        """Store how a job ended, again and again while the database is away, as long as a lease lasts."""
        until = time.monotonic() + self._settings.job_lease_s
        while True:
            try:
                return store()
            except OperationalError as error:
                if time.monotonic() > until:
                    raise
                self._say_away(error)
                time.sleep(POLL_S)

    def _say_away(self, error: OperationalError) -> None:
        log.warning("database_away", worker=self.name, error=str(error.orig))

    def _abandon(self, claim: Claim, *, lost: bool) -> str:
        if lost:
            return "lease_lost"
        self._queue.cancel(claim)
        return "cancelled"

    def _keep_house(self) -> None:
        """Signs of life, jobs of silent workers, old rows; each only as often as needed."""
        now = time.monotonic()
        if now - self._last_beat >= self._beat_every_s:
            self._last_beat = now
            self._queue.beat(self.name)
            if count := self._queue.reap():
                log.warning("jobs_reaped", count=count)
        if now - self._last_purge >= PURGE_EVERY_S:
            self._last_purge = now
            purge(
                self._database,
                jobs_after_days=self._settings.job_retention_days,
                answers_after_hours=self._settings.idempotency_hours,
            )
