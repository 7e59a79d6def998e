"""`/v1/drape-distances`: how alike two fabrics drape."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends
from fastapi.responses import JSONResponse

from services.api.auth import Caller, require
from services.api.documented import accepted, problems
from services.api.idempotency import IdempotencyKey
from services.api.json_body import JsonRoute
from services.api.scopes import ApiScope
from services.api.state import ServiceState, get_state
from services.api.submit import submit_job
from services.api.views import JobView
from services.jobs.kinds.drape_distance import DrapeDistanceInputs

router = APIRouter(prefix="/v1/drape-distances", tags=["drape distance"], route_class=JsonRoute)


@router.post(
    "",
    status_code=202,
    response_model=JobView,
    responses={**accepted("Queued"), **problems(413, 415, 429)},
    summary="Compare two fabrics",
)
def create_drape_distance(
    inputs: DrapeDistanceInputs,
    state: Annotated[ServiceState, Depends(get_state)],
    caller: Annotated[Caller, Depends(require(ApiScope.DISTANCES_WRITE))],
    idempotency_key: IdempotencyKey = None,
) -> JSONResponse:
    """Simulates both fabrics in both scenes, which takes seconds to minutes: poll the job named by `Location`.

    The job's `result` holds `distance`, `standard_error`, `scenes` (`hanging`, `stretch`), `simulations`, `backend`,
    `unit`, `simulated_again` and `raised_bias`: of `a` or `b`, where no plate has its `bending_bias`, what it was
    simulated with. Scope `distances:write`.
    """
    inputs.check()
    return submit_job(state, caller, idempotency_key, "drape_distance", inputs)
