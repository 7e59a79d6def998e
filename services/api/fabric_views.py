"""A fabric as it comes in and goes out."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from services.api.problems import ProblemError
from services.db.fabrics import Fabric
from services.patterns import NO_NUL
from services.schemas import EXAMPLE_PARAMETERS, Parameters, Strict

ShortText = Annotated[str, Field(min_length=1, max_length=80, pattern=NO_NUL)]
LongText = Annotated[str, Field(min_length=1, max_length=200, pattern=NO_NUL)]


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
    model_version: LongText | None = Field(
        default=None, max_length=120, description="The model, when the parameters were estimated."
    )
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


def plm_ref_taken(ref: PlmRef) -> ProblemError:
    """409: another fabric has it."""
    return ProblemError(409, "plm_ref_taken", f"{ref.system} {ref.id} revision {ref.revision} is there already")


def same_plm_ref(ref: PlmRef) -> tuple[Any, ...]:
    """Condition that a row has this reference."""
    return Fabric.plm_system == ref.system, Fabric.plm_id == ref.id, Fabric.plm_revision == ref.revision


def etag(row: Fabric) -> str:
    """Changes whenever the fabric does."""
    return f'"{row.id}-{row.version}"'


def names_version(header: str, row: Fabric) -> bool:
    """Whether an ``If-Match`` or ``If-None-Match`` header names the row's present version."""
    tags = {tag.strip().removeprefix("W/") for tag in header.split(",")}
    return "*" in tags or etag(row) in tags


def fill(row: Fabric, fabric: FabricInput) -> None:
    """Write what came in into a row."""
    ref = fabric.plm_ref
    row.name = fabric.name
    row.parameters = fabric.parameters.model_dump(mode="json")
    row.plm_system = ref.system if ref else None
    row.plm_id = ref.id if ref else None
    row.plm_revision = ref.revision if ref else None
    row.attributes = dict(fabric.attributes)
    row.model_version = fabric.model_version


def view_fabric(row: Fabric) -> FabricView:
    """What goes out of a row."""
    return FabricView(
        id=row.id,
        name=row.name,
        parameters=row.parameters,
        plm_ref=None if row.plm_ref is None else PlmRef(**row.plm_ref),
        model_version=row.model_version,
        attributes=row.attributes,
        version=row.version,
        created_at=row.created_at,
        updated_at=row.updated_at,
    )
