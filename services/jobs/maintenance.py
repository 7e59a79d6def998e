"""Forgetting what is old."""

from __future__ import annotations

from datetime import timedelta

from sqlalchemy import delete, select

from services.db.engine import Database, in_turn
from services.db.idempotency import IdempotencyRecord
from services.db.jobs import Job, JobFile, JobStatus

PURGE_LOCK = 0x70757267
"""Under which servers and workers forget one after the other (the letters 'purg')."""


def purge(database: Database, *, jobs_after_days: float, answers_after_hours: float) -> None:
    """Remove ended jobs and remembered answers past their time, and inputs of jobs that have ended."""
    now = database.now
    final = [status.value for status in JobStatus if status.final]
    ended = select(Job.number).where(Job.status.in_(final))
    old = ended.where(Job.finished_at < now - timedelta(days=jobs_after_days))
    with database.write() as session:
        in_turn(session, PURGE_LOCK)
        session.execute(delete(JobFile).where(JobFile.role == "input", JobFile.job_number.in_(ended)))
        session.execute(delete(JobFile).where(JobFile.job_number.in_(old)))
        session.execute(
            delete(Job).where(Job.status.in_(final), Job.finished_at < now - timedelta(days=jobs_after_days))
        )
        session.execute(
            delete(IdempotencyRecord).where(IdempotencyRecord.created_at < now - timedelta(hours=answers_after_hours))
        )
