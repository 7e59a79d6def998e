"""`/v1/fabrics`: the library."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Path, Query, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy import select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from services.api.auth import Caller, require
from services.api.documented import problems
from services.api.idempotency import Answer, IdempotencyKey, Once, fingerprint
from services.api.paging import Cursor, Limit, decode_cursor, encode_cursor
from services.api.problems import ProblemError
from services.api.scopes import ApiScope
from services.api.state import ServiceState, get_state
from services.db.fabrics import Fabric
from services.schemas import EXAMPLE_PARAMETERS, Parameters, Strict

router = APIRouter(prefix="/v1/fabrics", tags=["fabrics"])
State = Annotated[ServiceState, Depends(get_state)]
Reader = Annotated[Caller, Depends(require(ApiScope.FABRICS_READ))]
Writer = Annotated[Caller, Depends(require(ApiScope.FABRICS_WRITE))]
ShortText = Annotated[str, Field(min_length=1, max_length=80, pattern=r"^[^\x00]*$")]
LongText = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00]*$")]


class PlmRef(Strict):
    """Where a product-lifecycle system knows the fabric; the three together are unique."""

    system: ShortText = Field(examples=["windchill"])
    id: LongText = Field(examples=["FAB-004711"])
    revision: ShortText = Field(examples=["B"])


class FabricInput(Strict):
    """A fabric to add."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "name": "Cotton twill 200",
                    "parameters": EXAMPLE_PARAMETERS,
                    "plm_ref": {"system": "windchill", "id": "FAB-004711", "revision": "B"},
                    "model_version": None,
                    "attributes": {"composition": "100 % cotton"},
                }
            ]
        }
    )

    name: LongText
    parameters: Parameters
    plm_ref: PlmRef | None = None
    model_version: LongText | None = Field(default=None, description="The model, when the parameters were estimated.")
    attributes: dict[ShortText, LongText] = Field(default_factory=dict, max_length=50, description="Anything else.")


class FabricView(BaseModel):
    """A fabric of the library."""

    id: str = Field(examples=["fab_0f3a5c7e9b1d2f4a6c8e0a1b3c5d7e9f"])
    name: str
    parameters: dict[str, float]
    plm_ref: PlmRef | None
    model_version: str | None
    attributes: dict[str, Any]
    version: int
    created_at: datetime
    updated_at: datetime


class FabricPage(BaseModel):
    """A page of fabrics, oldest first."""

    items: list[FabricView]
    next_cursor: str | None = Field(description="Cursor of the next page; null on the last.")


@router.post(
    "",
    status_code=201,
    response_model=FabricView,
    responses={201: {"headers": {"Location": {"schema": {"type": "string"}}}}, **problems(409)},
    summary="Add a fabric",
)
def create_fabric(
    fabric: FabricInput, state: State, caller: Writer, idempotency_key: IdempotencyKey = None
) -> JSONResponse:
    """Scope `fabrics:write`. A `plm_ref` that is there already gives 409 `plm_ref_taken`."""
    content = fabric.model_dump(mode="json")
    once = Once(state.database, caller, idempotency_key, fingerprint("fabrics", content))
    ref = fabric.plm_ref

    def make(session: Session) -> Answer:
        if ref is not None and session.scalar(select(Fabric.id).where(*_same(ref))) is not None:
            raise _taken(ref)
        row = Fabric(
            name=fabric.name,
            parameters=content["parameters"],
            plm_system=ref.system if ref else None,
            plm_id=ref.id if ref else None,
            plm_revision=ref.revision if ref else None,
            attributes=dict(fabric.attributes),
            model_version=fabric.model_version,
        )
        session.add(row)
        session.flush()
        return Answer(201, _view(row).model_dump(mode="json"), {"Location": f"/v1/fabrics/{row.id}", "ETag": _tag(row)})

    try:
        return once.answer(make)
    except IntegrityError:
        if ref is None:
            raise
        raise _taken(ref) from None  # somebody added the same at the same moment


@router.get("", responses=problems(), summary="List fabrics")
def list_fabrics(
    state: State,
    caller: Reader,
    limit: Limit = 50,
    cursor: Cursor = None,
    plm_system: Annotated[str | None, Query(max_length=80)] = None,
    plm_id: Annotated[str | None, Query(max_length=200)] = None,
) -> FabricPage:
    """Oldest first; scope `fabrics:read`. Follow `next_cursor` until it is null."""
    wanted = select(Fabric).where(Fabric.number > decode_cursor(cursor)).order_by(Fabric.number).limit(limit + 1)
    if plm_system is not None:
        wanted = wanted.where(Fabric.plm_system == plm_system)
    if plm_id is not None:
        wanted = wanted.where(Fabric.plm_id == plm_id)
    with state.database.read() as session:
        rows = session.scalars(wanted).all()
    page = rows[:limit]
    more = len(rows) > limit
    return FabricPage(items=[_view(row) for row in page], next_cursor=encode_cursor(page[-1].number) if more else None)


@router.get(
    "/{fabric_id}",
    response_model=FabricView,
    responses={304: {"description": "Not changed since `If-None-Match`"}, **problems(404)},
    summary="A fabric",
)
def get_fabric(
    fabric_id: Annotated[str, Path(max_length=48)],
    state: State,
    caller: Reader,
    if_none_match: Annotated[str | None, Header(max_length=200)] = None,
) -> Response:
    """Scope `fabrics:read`; answers with an `ETag`."""
    with state.database.read() as session:
        row = session.scalar(select(Fabric).where(Fabric.id == fabric_id))
    if row is None:
        raise ProblemError(404, "fabric_not_found", "there is no such fabric")
    headers = {"ETag": _tag(row)}
    known = {tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")}
    if "*" in known or _tag(row) in known:
        return Response(status_code=304, headers=headers)
    return JSONResponse(_view(row).model_dump(mode="json"), headers=headers)


def _taken(ref: PlmRef) -> ProblemError:
    return ProblemError(409, "plm_ref_taken", f"{ref.system} {ref.id} revision {ref.revision} is there already")


def _same(ref: PlmRef) -> tuple[Any, ...]:
    return Fabric.plm_system == ref.system, Fabric.plm_id == ref.id, Fabric.plm_revision == ref.revision


def _tag(row: Fabric) -> str:
    return f'"{row.id}-{row.version}"'


def _view(row: Fabric) -> FabricView:
    ref = None
    if row.plm_system is not None and row.plm_id is not None and row.plm_revision is not None:
        ref = PlmRef(system=row.plm_system, id=row.plm_id, revision=row.plm_revision)
    return FabricView(
        id=row.id,
        name=row.name,
        parameters=row.parameters,
        plm_ref=ref,
        model_version=row.model_version,
        attributes=row.attributes,
        version=row.version,
        created_at=row.created_at,
        updated_at=row.updated_at,
    )
