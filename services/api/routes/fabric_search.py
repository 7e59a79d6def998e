"""`/v1/fabrics/search`: which fabrics of the library drape most like a reference."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends
from fastapi.responses import JSONResponse
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.api.auth import Caller, require
from services.api.documented import accepted, problems
from services.api.idempotency import IdempotencyKey
from services.api.json_body import JsonRoute
from services.api.problems import ProblemError
from services.api.scopes import ApiScope
from services.api.state import ServiceState, get_state
from services.api.submit import submit_job
from services.api.views import JobView
from services.db.fabrics import Fabric
from services.jobs.kinds.fabric_search import FabricSearchInputs

router = APIRouter(prefix="/v1/fabrics/search", tags=["fabrics"], route_class=JsonRoute)


@router.post(
    "",
    status_code=202,
    response_model=JobView,
    responses={**accepted("Queued"), **problems(404, 413, 415, 429)},
    summary="Search by drape",
)
def create_fabric_search(
    inputs: FabricSearchInputs,
    state: Annotated[ServiceState, Depends(get_state)],
    caller: Annotated[Caller, Depends(require(ApiScope.FABRICS_READ))],
    idempotency_key: IdempotencyKey = None,
) -> JSONResponse:
    """Simulates what has not been simulated before: poll the job named by `Location`.

    The job's `result` holds `ranking` (`id`, `name`, `plm_ref`, `distance`, `standard_error`, `thumbnails`), nearest
    first, `failed`, `searched`, `simulations`, `backend`, `unit` and `raised_bias`: by `id` (`reference`: of given
    parameters), where no plate has the fabric's `bending_bias`, what it was simulated with. Scope `fabrics:read`.
    """
    inputs.check()

    def check(session: Session) -> None:
        wanted = inputs.fabric_id
        if wanted is not None and session.scalar(select(Fabric.id).where(Fabric.id == wanted)) is None:
            raise ProblemError(404, "fabric_not_found", "there is no such fabric to look for")

    return submit_job(state, caller, idempotency_key, "fabric_search", inputs, check=check)
