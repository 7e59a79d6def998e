"""A server forgets what is old by itself: it may have no worker that does."""

from __future__ import annotations

import asyncio

import structlog
from fastapi.concurrency import run_in_threadpool

from services.api.state import ServiceState
from services.db.engine import DATABASE_FAILED
from services.jobs.maintenance import purge

PURGE_EVERY_S = 600.0

log = structlog.get_logger("drapemeter.api")


async def keep_house(state: ServiceState) -> None:
    """At once and then now and then, until it is cancelled."""
    while True:
        await run_in_threadpool(_forget, state)
        await asyncio.sleep(PURGE_EVERY_S)


def _forget(state: ServiceState) -> None:
    """Once; a database that is away has it done the next time."""
    settings = state.settings
    try:
        purge(
            state.database,
            jobs_after_days=settings.job_retention_days,
            answers_after_hours=settings.idempotency_hours,
        )
    except DATABASE_FAILED as error:
        log.warning("purge_failed", error=str(getattr(error, "orig", None) or error))
