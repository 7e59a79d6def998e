"""Jobs as the database has them."""

from __future__ import annotations

from sqlalchemy import select

from services.db.engine import Database
from services.db.jobs import Job


def read_job(database: Database, job_id: str) -> Job:
    """The row of a job."""
    with database.read() as session:
        return session.scalars(select(Job).where(Job.id == job_id)).one()
