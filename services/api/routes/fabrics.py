"""`/v1/fabrics`: the library."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Header, Path, Query, Response
from fastapi.responses import JSONResponse
from sqlalchemy import select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from services.api.auth import Caller, require
from services.api.documented import ETAG, problems
from services.api.fabric_views import (
    FabricInput,
    FabricPage,
    FabricView,
    PlmRef,
    etag,
    fill,
    names_version,
    plm_ref_taken,
    same_plm_ref,
    view_fabric,
)
from services.api.forms import known_parameters_only
from services.api.idempotency import Answer, IdempotencyKey, Once, fingerprint
from services.api.json_body import JsonRoute
from services.api.paging import Cursor, Limit, decode_cursor, encode_cursor
from services.api.problems import ProblemError
from services.api.scopes import ApiScope
from services.api.state import ServiceState, get_state
from services.db.base import utc_now
from services.db.engine import in_turn
from services.db.fabrics import Fabric
from services.patterns import NO_NUL, PRINTABLE

router = APIRouter(prefix="/v1/fabrics", tags=["fabrics"], route_class=JsonRoute)
FABRICS_LOCK = 0x66616272
"""Under which fabrics are added one after the other (the letters 'fabr')."""
MOST_TAGS = 4000
"""Characters of a list of `ETag`s: caches send one for each variant that they keep."""
State = Annotated[ServiceState, Depends(get_state)]
Reader = Annotated[Caller, Depends(require(ApiScope.FABRICS_READ))]
Writer = Annotated[Caller, Depends(require(ApiScope.FABRICS_WRITE))]
FabricId = Annotated[str, Path(max_length=48, pattern=PRINTABLE, examples=["fab_0f3a5c7e9b1d2f4a6c8e0a1b3c5d7e9f"])]
IfMatch = Annotated[
    str | None, Header(alias="If-Match", max_length=MOST_TAGS, description="`ETag` of the version that is meant.")
]


@router.post(
    "",
    status_code=201,
    response_model=FabricView,
    responses={201: {"headers": {"Location": {"schema": {"type": "string"}}, **ETAG}}, **problems(409, 413, 415)},
    summary="Add a fabric",
)
def create_fabric(
    fabric: FabricInput, state: State, caller: Writer, idempotency_key: IdempotencyKey = None
) -> JSONResponse:
    """Scope `fabrics:write`. A `plm_ref` that is there already gives 409 `plm_ref_taken`."""
    content = fabric.model_dump(mode="json")
    hours = state.settings.idempotency_hours
    once = Once(state.database, caller, idempotency_key, fingerprint("fabrics", content), hours)

    def make(session: Session) -> Answer:
        in_turn(session, FABRICS_LOCK)  # who reads on from a number must have seen all before it
        _require_free(session, fabric.plm_ref, but=0)
        row = Fabric()
        fill(row, fabric)
        session.add(row)
        session.flush()
        headers = {"Location": f"/v1/fabrics/{row.id}", "ETag": etag(row)}
        return Answer(201, view_fabric(row).model_dump(mode="json"), headers)

    try:
        return once.answer(make)
    except IntegrityError:
        if fabric.plm_ref is None:
            raise
        raise plm_ref_taken(fabric.plm_ref) from None  # somebody added the same at the same moment


@router.get("", responses=problems(), summary="List fabrics")
def list_fabrics(
    state: State,
    caller: Reader,
    _query: Annotated[None, Depends(known_parameters_only)],
    limit: Limit = 50,
    cursor: Cursor = None,
    plm_system: Annotated[str | None, Query(max_length=80, pattern=NO_NUL)] = None,
    plm_id: Annotated[str | None, Query(max_length=200, pattern=NO_NUL)] = None,
    plm_revision: Annotated[str | None, Query(max_length=80, pattern=NO_NUL)] = None,
) -> FabricPage:
    """Oldest first; scope `fabrics:read`. Follow `next_cursor` until it is null."""
    wanted = select(Fabric).where(Fabric.number > decode_cursor(cursor)).order_by(Fabric.number).limit(limit + 1)
    if plm_system is not None:
        wanted = wanted.where(Fabric.plm_system == plm_system)
    if plm_id is not None:
        wanted = wanted.where(Fabric.plm_id == plm_id)
    if plm_revision is not None:
        wanted = wanted.where(Fabric.plm_revision == plm_revision)
    with state.database.read() as session:
        rows = session.scalars(wanted).all()
    page = rows[:limit]
    more = len(rows) > limit
    next_cursor = encode_cursor(page[-1].number) if more else None
    return FabricPage(items=[view_fabric(row) for row in page], next_cursor=next_cursor)


@router.get(
    "/{fabric_id}",
    response_model=FabricView,
    responses={
        200: {"headers": ETAG},
        304: {"description": "Not changed since `If-None-Match`", "headers": ETAG},
        **problems(404),
    },
    summary="A fabric",
)
def get_fabric(
    fabric_id: FabricId,
    state: State,
    caller: Reader,
    if_none_match: Annotated[str | None, Header(max_length=MOST_TAGS)] = None,
) -> Response:
    """Scope `fabrics:read`; answers with an `ETag`."""
    with state.database.read() as session:
        row = _find(session, fabric_id, None, lock=False)
    if if_none_match is not None and names_version(if_none_match, row):
        return Response(status_code=304, headers={"ETag": etag(row)})
    return JSONResponse(view_fabric(row).model_dump(mode="json"), headers={"ETag": etag(row)})


@router.put(
    "/{fabric_id}",
    response_model=FabricView,
    responses={200: {"headers": ETAG}, **problems(404, 409, 412, 413, 415)},
    summary="Replace a fabric",
)
def replace_fabric(
    fabric_id: FabricId, fabric: FabricInput, state: State, caller: Writer, if_match: IfMatch = None
) -> JSONResponse:
    """The whole of it: what is left out is gone. Scope `fabrics:write`.

    With `If-Match`, only the version that is meant is changed; else 412.
    """
    try:
        with state.database.write() as session:
            row = _find(session, fabric_id, if_match)
            _require_free(session, fabric.plm_ref, but=row.number)
            fill(row, fabric)
            row.version += 1
            row.updated_at = utc_now()
            session.flush()
            return JSONResponse(view_fabric(row).model_dump(mode="json"), headers={"ETag": etag(row)})
    except IntegrityError:
        if fabric.plm_ref is None:
            raise
        raise plm_ref_taken(fabric.plm_ref) from None


@router.delete("/{fabric_id}", status_code=204, responses=problems(404, 412), summary="Remove a fabric")
def delete_fabric(fabric_id: FabricId, state: State, caller: Writer, if_match: IfMatch = None) -> Response:
    """Scope `fabrics:write`."""
    with state.database.write() as session:
        session.delete(_find(session, fabric_id, if_match))
    return Response(status_code=204)


def _find(session: Session, fabric_id: str, if_match: str | None, *, lock: bool = True) -> Fabric:
    """The row, locked when it is to be changed."""
    wanted = select(Fabric).where(Fabric.id == fabric_id)
    row = session.scalar(wanted.with_for_update() if lock else wanted)
    if row is None:
        raise ProblemError(404, "fabric_not_found", "there is no such fabric")
    if if_match is not None and not names_version(if_match, row):
        raise ProblemError(412, "version_changed", "the fabric was changed meanwhile: read it again")
    return row


def _require_free(session: Session, ref: PlmRef | None, *, but: int) -> None:
    if ref is None:
        return
    if session.scalar(select(Fabric.id).where(*same_plm_ref(ref), Fabric.number != but)) is not None:
        raise plm_ref_taken(ref)
