"""`/v1/datasets`: synthetic depth pictures to train on."""

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
from services.jobs.kinds.dataset import DatasetInputs

router = APIRouter(prefix="/v1/datasets", tags=["datasets"], route_class=JsonRoute)


@router.post(
    "",
    status_code=202,
    response_model=JobView,
    responses={**accepted("Queued"), **problems(413, 415, 429)},
    summary="Sweep fabrics into a store",
)
def create_dataset(
    inputs: DatasetInputs,
    state: Annotated[ServiceState, Depends(get_state)],
    caller: Annotated[Caller, Depends(require(ApiScope.DATASETS_WRITE))],
    idempotency_key: IdempotencyKey = None,
) -> JSONResponse:
    """The server decides where the store goes; the job's `result` holds `store`, `samples`, `failed` and `seconds`.

    Scope `datasets:write`.
    """
    inputs.check()
    return submit_job(state, caller, idempotency_key, "dataset", inputs)
