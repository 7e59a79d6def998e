"""`/healthz`, `/readyz`, `/metrics`."""

from __future__ import annotations

from datetime import timedelta
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Response
from fastapi.responses import JSONResponse
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from pydantic import BaseModel
from sqlalchemy import select

from services.api.auth import Caller, require
from services.api.documented import problems
from services.api.scopes import ApiScope
from services.api.state import ServiceState, get_state
from services.db.engine import DATABASE_FAILED
from services.db.jobs import Worker
from services.db.migrate import is_usable
from services.model_folder import find_model

router = APIRouter(tags=["health"])
State = Annotated[ServiceState, Depends(get_state)]


class Health(BaseModel):
    """The process answers."""

    status: Literal["ok"] = "ok"


class Readiness(BaseModel):
    """Whether requests can be served; workers and model are told but only the database is needed."""

    status: Literal["ready", "not_ready"]
    database: Literal["ok", "unreachable", "not_migrated"]
    workers: int
    model: Literal["present", "absent"]


@router.get("/healthz", summary="Does the process answer?")
async def healthz() -> Health:
    """No key needed."""
    return Health()


@router.get(
    "/readyz",
    summary="Can requests be served?",
    response_model=Readiness,
    responses={503: {"model": Readiness, "description": "Not ready"}},
)
def readyz(state: State) -> JSONResponse:
    """No key needed."""
    database: Literal["ok", "unreachable", "not_migrated"] = "ok"
    workers = 0
    try:
        database = "ok" if is_usable(state.database) else "not_migrated"
        if database == "ok":
            recent = state.database.now - timedelta(seconds=state.settings.job_lease_s)
            with state.database.read() as session:
                workers = len(session.scalars(select(Worker.id).where(Worker.seen_at > recent)).all())
    except DATABASE_FAILED:
        database = "unreachable"
    readiness = Readiness(
        status="ready" if database == "ok" else "not_ready",
        database=database,
        workers=workers,
        model="present" if find_model(state.settings.model) is not None else "absent",
    )
    return JSONResponse(readiness.model_dump(mode="json"), 200 if database == "ok" else 503)


@router.get(
    "/metrics",
    summary="Counters for Prometheus",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}, **problems()},
)
def metrics(state: State, caller: Annotated[Caller, Depends(require(ApiScope.METRICS_READ))]) -> Response:
    """Prometheus text format; scope `metrics:read`."""
    return Response(generate_latest(state.metrics.registry), headers={"Content-Type": CONTENT_TYPE_LATEST})
