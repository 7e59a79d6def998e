"""Turning a request into a job and 202."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

from fastapi.responses import JSONResponse
from pydantic import BaseModel
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from services.api.auth import Caller
from services.api.idempotency import Answer, Once, fingerprint
from services.api.problems import ProblemError
from services.api.state import ServiceState
from services.api.views import job_headers, view_job
from services.db.jobs import Job, JobStatus
from services.jobs.files import FileContent
from services.jobs.queue import enqueue


def submit_job(
    state: ServiceState,
    caller: Caller,
    key: str | None,
    kind: str,
    inputs: BaseModel,
    *,
    files: Sequence[FileContent] = (),
    own: Collection[str] = (),
    check: Callable[[Session], None] = lambda session: None,
) -> JSONResponse:
    """Queue a job once under its Idempotency-Key.

    Args:
        state: of the application.
        caller: who asks.
        key: the header, if it was sent.
        kind: of the job.
        inputs: what is asked. What is left at its default does not tell one request from another: under its key a
            request stays the same when a later version of the service can be asked for more.
        files: what was sent with it.
        check: refuses, in the transaction, what an earlier answer under the key is given for.
        own: names of inputs that are the server's: with others the same request is still the same.

    Raises:
        ProblemError: 422 when the key was used for another request, 429 when too many jobs wait.
    """
    asked = inputs.model_dump(mode="json", exclude=set(own), exclude_defaults=True)
    content = {"inputs": asked, "files": {file.name: file.content for file in files}}
    once = Once(state.database, caller, key, fingerprint(f"job {kind}", content), state.settings.idempotency_hours)

    def make(session: Session) -> Answer:
        check(session)
        waiting = session.scalar(select(func.count()).select_from(Job).where(Job.status == JobStatus.QUEUED)) or 0
        if waiting >= state.settings.job_queue:
            detail = f"{waiting} jobs are waiting already: try again when some have ended"
            raise ProblemError(429, "jobs_saturated", detail, {"Retry-After": "60"})
        job = enqueue(session, kind, inputs.model_dump(mode="json"), files=files, owner=caller.key_id)
        return Answer(202, view_job(session, job).model_dump(mode="json"), job_headers(job))

    return once.answer(make)
