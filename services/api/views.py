"""What answers look like."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, Field
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.db.jobs import Job, JobFile, JobStatus

StatusName = Literal["queued", "running", "succeeded", "failed", "cancelled"]
POLL_AFTER_S = 2


class JobFileView(BaseModel):
    """A file that a job left."""

    name: str
    media_type: str
    url: str


class JobProblem(BaseModel):
    """Why a job failed."""

    code: str = Field(examples=["simulation_not_still"])
    detail: str


class JobView(BaseModel):
    """A job."""

    id: str = Field(examples=["job_0f3a5c7e9b1d2f4a6c8e0a1b3c5d7e9f"])
    kind: Literal["drape_distance", "fabric_search", "diagnosis", "dataset", "estimate"]
    status: StatusName
    progress: float = Field(ge=0, le=1)
    message: str = Field(description="What it is doing.")
    attempts: int = Field(description="How often it was begun; more than once after a crash.")
    result: dict[str, Any] | None = Field(description="When succeeded; its form belongs to the kind.")
    problem: JobProblem | None = Field(description="When failed.")
    files: list[JobFileView]
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None


def view_job(session: Session, job: Job) -> JobView:
    """A job with the files it left."""
    outputs = session.scalars(
        select(JobFile).where(JobFile.job_number == job.number, JobFile.role == "output").order_by(JobFile.name)
    )
    return JobView.model_validate(
        {
            "id": job.id,
            "kind": job.kind,
            "status": job.status,
            "progress": job.progress,
            "message": job.message,
            "attempts": job.attempts,
            "result": job.result,
            "problem": job.problem,
            "files": [
                {"name": f.name, "media_type": f.media_type, "url": f"/v1/jobs/{job.id}/files/{f.name}"}
                for f in outputs
            ],
            "created_at": job.created_at,
            "started_at": job.started_at,
            "finished_at": job.finished_at,
        }
    )


def job_headers(job: Job) -> dict[str, str]:
    """Headers of an answer that is a job."""
    headers = {"Location": f"/v1/jobs/{job.id}"}
    if not JobStatus(job.status).final:
        headers["Retry-After"] = str(POLL_AFTER_S)
    return headers
