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
from dataclasses import dataclass

import structlog
from sqlalchemy.exc import DataError, SQLAlchemyError

from services.db.engine import DATABASE_AWAY, DATABASE_FAILED, Database, is_full
from services.jobs.execute import execute, gather
from services.jobs.maintenance import purge
from services.jobs.queue import Claim, JobQueue
from services.jobs.scratch import clear_abandoned, make_scratch, remove_scratch
from services.jobs.task import NO_ROOM, Call, Crashed, Done, Progress, Refused, Resources, Runner, Task, TaskOutput
from services.settings import Settings

POLL_S = 0.3
"""How often the queue is looked at when there is nothing to do, and a job's process when there is."""
PURGE_EVERY_S = 600.0
AWAY_S = 1.0
"""How soon a database that did not answer is asked again."""
PAUSE_S = 5.0
"""How soon a job is begun again that this machine or the cluster could not take on."""
BEHIND_S = 60.0
"""So long after a job found no cluster all others come before it."""
CLOCK_STEP_S = 2.0
"""By how much this machine's clock may go off from one look to the next before it counts as set, or as having slept."""
RAY_AWAY = frozenset({"cluster_missing", "cluster_lost", "workers_missing"})
NO_FAULT = RAY_AWAY | {"store_unreachable", "store_no_space", NO_ROOM}
"""What a job is refused for that is no fault of its own: a cluster or a store that is away, a disk that is full."""

log = structlog.get_logger("drapemeter.worker")


@dataclass(frozen=True)
class _Waiting:
    """A job waits for a cluster, a store or for room since then, on the monotonic clock [s].

    Attributes:
        since: when it was given back first.
        reached: the fraction that it came to.
        behind_until: other jobs, which may need no cluster, are done first till then.
    """

    since: float
    reached: float
    behind_until: float


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
        self._last_beat = self._last_purge = self._reaps_from = float("-inf")
        self._clock_ahead_s = time.time() - time.monotonic()
        self._waiting: dict[str, _Waiting] = {}

    def run(self) -> None:
        """Until ``stopping`` is set."""
        log.info("worker_started", worker=self.name, abandoned_folders=clear_abandoned())
        self._spare_others()  # the database may just have come back, which is why this one is started
        try:
            while not self._stopping.is_set():
                try:
                    self._keep_house()
                    claim = self._queue.claim(self.name, last=self._behind())
                    if claim is None:
                        self._stopping.wait(POLL_S)
                    else:
                        self.work(claim)
                except DATABASE_FAILED as error:
                    self._runner.stop()
                    self._say_away(error)
                    self._stopping.wait(AWAY_S)
        finally:
            self._runner.stop()
            with suppress(*DATABASE_FAILED):
                self._queue.leave(self.name)
            log.info("worker_stopped", worker=self.name)

    def work(self, claim: Claim) -> None:
        """Do one job and store how it ended."""
        job_log = log.bind(job=claim.id, kind=claim.kind, attempt=claim.attempt)
        job_log.info("job_started")
        try:
            scratch = make_scratch()
        except OSError as error:
            self._give_back_for_now(
                claim, f"no folder to work in: {error}; make room in TMPDIR, or name another folder in it"
            )
            return
        try:
            with self._database.read() as session:
                inputs = gather(session, claim.kind, claim.inputs)
            resources = Resources(self._settings.dataset_root, self._settings.ray_address, self._settings.model)
            task = Task(claim.id, claim.kind, inputs, claim.files, resources, scratch)
            try:
                self._runner.start(Call(self._work, (task,), {"job": claim.id, "kind": claim.kind}))
            except OSError as error:
                self._give_back_for_now(
                    claim, f"no process to work in: {error}; free memory or processes on this machine"
                )
                return
            outcome = self._watch(claim)
        finally:
            remove_scratch(scratch)
        job_log.info("job_ended", outcome=outcome)

    def _watch(self, claim: Claim) -> str:
        """Wait for the end of a job; its name for the log."""
        began, next_renewal = time.monotonic(), 0.0
        latest = Progress(0.0)
        stop_at: float | None = None
        while True:
            event = self._runner.poll(POLL_S)
            if isinstance(event, Progress):
                latest = event
                waiting = self._waiting.get(claim.id)
                if waiting is not None and event.fraction > waiting.reached:
                    del self._waiting[claim.id]  # further than before: what it waited for is back
            elif event is not None:
                return self._settle(claim, event, latest.fraction)
            now = time.monotonic()
            if now >= next_renewal:
                next_renewal = now + min(self._beat_every_s, 1.0)
                going_on: bool | None = True
                try:
                    going_on = self._queue.renew(claim, progress=latest.fraction, message=latest.message)
                    self._keep_house()
                except DATABASE_FAILED as error:
                    self._say_away(error)  # and go on: should another worker have taken the job, nothing is stored
                if not going_on:
                    self._runner.stop()
                    return self._abandon(claim, lost=going_on is None)
            if now - began > self._settings.job_time_limit_s:
                self._runner.stop()
                limit = f"{self._settings.job_time_limit_s:g} s"
                self._refuse(claim, "job_timed_out", f"the job took more than {limit} and was stopped")
                return "timed_out"
            if self._stopping.is_set():
                stop_at = stop_at if stop_at is not None else now + self._settings.job_shutdown_grace_s
                if now >= stop_at:
                    self._runner.stop()
                    self._insist(lambda: self._queue.release(claim, count_attempt=False))
                    return "given_back"

    def _settle(self, claim: Claim, event: Done | Refused | Crashed, reached: float) -> str:
        if isinstance(event, Refused) and event.code in NO_FAULT and self._may_wait(claim, reached, event.code):
            self._give_back_for_now(claim, event.detail)
            return "given_back"
        self._waiting.pop(claim.id, None)
        if isinstance(event, Done):
            return self._store(claim, event.value)
        if isinstance(event, Refused):
            self._refuse(claim, event.code, event.detail)
            return "failed"
        if self._stopping.is_set():  # a signal to the whole group ends a job's process before the worker stops it
            self._insist(lambda: self._queue.release(claim, count_attempt=False))
            return "given_back"
        log.error("job_process_crashed", job=claim.id, reason=event.reason)
        if event.again:
            self._insist(lambda: self._queue.release(claim, count_attempt=True))
            return "crashed"
        self._refuse(claim, "internal_error", "the job failed in a way that nobody foresaw; see the worker's log")
        return "failed"

    def _store(self, claim: Claim, output: TaskOutput) -> str:
        """What a job has made; what the database does not take is a failure of the job, whoever runs it again."""
        try:
            stored = self._insist(lambda: self._queue.succeed(claim, output.result, output.files))
        except DataError as error:
            log.error("result_refused", job=claim.id, error=str(error.orig))
            self._refuse(claim, "internal_error", "the result cannot be stored; see the worker's log")
            return "failed"
        return "succeeded" if stored else "lease_lost"

    def _refuse(self, claim: Claim, code: str, detail: str) -> None:
        self._insist(lambda: self._queue.fail(claim, code, detail))

    def _may_wait(self, claim: Claim, reached: float, code: str) -> bool:
        """Whether a job goes on waiting for what is away: for a while since it last came further."""
        now = time.monotonic()
        waiting = self._waiting.get(claim.id, _Waiting(now, reached, now))
        self._waiting[claim.id] = _Waiting(
            waiting.since, max(waiting.reached, reached), now + BEHIND_S * (code in RAY_AWAY)
        )
        return now - waiting.since < self._settings.job_cluster_patience_s

    def _behind(self) -> set[str]:
        """Jobs that found no cluster a moment ago."""
        now = time.monotonic()
        return {job for job, waiting in self._waiting.items() if now < waiting.behind_until}

    def _give_back_for_now(self, claim: Claim, why: str) -> None:
        """What cannot be done here and now is no fault of the job: it is begun again a little later, here or elsewhere.

        A machine without room would begin no other job either, so that there is no end to waiting for it.
        """
        log.error("job_waits", job=claim.id, reason=why)
        self._insist(lambda: self._queue.release(claim, count_attempt=False, message=f"waits: {why}"))
        self._stopping.wait(PAUSE_S)

    def _insist(self, store: Callable[[], bool]) -> bool:
        """Store how a job ended, again and again while the database is away; when stopping, as long as its grace."""
        until: float | None = None
        while True:
            try:
                return store()
            except DATABASE_AWAY as error:
                if self._stopping.is_set():
                    until = until if until is not None else time.monotonic() + self._settings.job_shutdown_grace_s
                    if time.monotonic() >= until:
                        raise
                self._say_away(error)
                time.sleep(POLL_S)

    def _say_away(self, error: SQLAlchemyError) -> None:
        """Tell it, and spare the others."""
        self._spare_others()
        log.warning(
            "database_full" if is_full(error) else "database_away",
            worker=self.name,
            error=str(getattr(error, "orig", None) or error),
        )

    def _spare_others(self) -> None:
        """Those who come back must have time to renew their leases before they are taken from them."""
        self._reaps_from = time.monotonic() + self._settings.job_lease_s

    def _look_at_clock(self) -> None:
        """Leases on SQLite go by this machine's clock: after it was set, or slept, all look silent that are alive."""
        ahead_s = time.time() - time.monotonic()
        step_s, self._clock_ahead_s = ahead_s - self._clock_ahead_s, ahead_s
        if abs(step_s) > CLOCK_STEP_S:
            self._spare_others()
            log.warning("clock_stepped", worker=self.name, seconds=round(step_s, 1))

    def _abandon(self, claim: Claim, *, lost: bool) -> str:
        if lost:
            return "lease_lost"
        self._insist(lambda: self._queue.cancel(claim))
        return "cancelled"

    def _keep_house(self) -> None:
        """Signs of life, jobs of silent workers, old rows; each only as often as needed."""
        self._look_at_clock()
        now = time.monotonic()
        if now - self._last_beat >= self._beat_every_s:
            self._last_beat = now
            self._queue.beat(self.name)
            if now >= self._reaps_from and (count := self._queue.reap()):
                log.warning("jobs_reaped", count=count)
        if now - self._last_purge >= PURGE_EVERY_S:
            self._last_purge = now
            purge(
                self._database,
                jobs_after_days=self._settings.job_retention_days,
                answers_after_hours=self._settings.idempotency_hours,
            )
            unfinished = self._queue.unfinished(self._waiting)  # one that waits may be cancelled, or end elsewhere
            self._waiting = {job: waiting for job, waiting in self._waiting.items() if job in unfinished}
