"""`/v1/jobs`: how long work is going, its result, its files, and stopping it."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Response
from fastapi.responses import JSONResponse
from sqlalchemy import select
from sqlalchemy.orm import Session, undefer

from services.api.auth import Caller, get_caller
from services.api.documented import problems
from services.api.problems import ProblemError
from services.api.scopes import ApiScope
from services.api.state import ServiceState, get_state
from services.api.views import JobView, job_headers, view_job
from services.db.jobs import Job, JobFile, JobStatus
from services.jobs.queue import request_cancel
from services.patterns import PRINTABLE

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])
State = Annotated[ServiceState, Depends(get_state)]
Asking = Annotated[Caller, Depends(get_caller)]
JobId = Annotated[str, Path(max_length=48, pattern=PRINTABLE, examples=["job_0f3a5c7e9b1d2f4a6c8e0a1b3c5d7e9f"])]


@router.get("/{job_id}", response_model=JobView, responses=problems(404), summary="A job")
def get_job(job_id: JobId, state: State, caller: Asking) -> JSONResponse:
    """One's own jobs, or any with scope `jobs:read`. `Retry-After` says when asking again is worth while."""
    with state.database.read() as session:
        job = _find(session, job_id, caller, ApiScope.JOBS_READ)
        body = view_job(session, job).model_dump(mode="json")
    return JSONResponse(body, headers=job_headers(job))


@router.delete(
    "/{job_id}",
    response_model=JobView,
    responses={202: {"model": JobView, "description": "It is being stopped"}, **problems(404, 409)},
    summary="Stop a job",
)
def cancel_job(job_id: JobId, state: State, caller: Asking) -> JSONResponse:
    """One's own jobs, or any with scope `jobs:write`. A waiting job is cancelled at once, a running one in a moment."""
    with state.database.write() as session:
        job = _find(session, job_id, caller, ApiScope.JOBS_WRITE)
        request_cancel(session, job)  # of one that has ended, maybe a moment ago, nothing changes
        if job.status in {JobStatus.SUCCEEDED, JobStatus.FAILED}:
            raise ProblemError(409, "job_ended", f"the job has {job.status} already")
        body = view_job(session, job).model_dump(mode="json")
    return JSONResponse(body, 200 if job.status == JobStatus.CANCELLED else 202, headers=job_headers(job))


@router.get(
    "/{job_id}/files/{name}",
    response_class=Response,
    responses={
        200: {
            "content": {
                kind: {"schema": {"type": "string", "format": "binary"}}
                for kind in ("application/octet-stream", "text/html", "image/png")
            }
        },
        **problems(404),
    },
    summary="A file that a job left",
)
def get_job_file(
    job_id: JobId, name: Annotated[str, Path(max_length=120, pattern=PRINTABLE)], state: State, caller: Asking
) -> Response:
    """Such as `report.html` of a diagnosis."""
    with state.database.read() as session:
        job = _find(session, job_id, caller, ApiScope.JOBS_READ)
        wanted = select(JobFile).where(JobFile.job_number == job.number, JobFile.role == "output", JobFile.name == name)
        file = session.scalar(wanted.options(undefer(JobFile.content)))
        if file is None:
            raise ProblemError(404, "file_not_found", "the job has no such file; 'files' of the job lists them")
        # Never shown inside the server's own origin: a report is a page that others' data went into.
        headers = {"Content-Disposition": f'attachment; filename="{file.name}"', "Content-Security-Policy": "sandbox"}
        return Response(file.content, media_type=file.media_type, headers=headers)


def _find(session: Session, job_id: str, caller: Caller, scope: ApiScope) -> Job:
    job = session.scalar(select(Job).where(Job.id == job_id))
    if job is None or not (caller.owns(job.owner) or caller.may(scope)):
        raise ProblemError(404, "job_not_found", "there is no such job, or it belongs to another API key")
    return job
