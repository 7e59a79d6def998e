"""The web page of a human study: one question at a time, every answer in the database at once.

Participants are known by an unguessable identifier in the page's address, which is also how they resume. Handlers are
plain functions: FastAPI runs them in its bounded pool of threads; the database takes threads, and nothing here
simulates or computes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, FastAPI, Request, Response
from fastapi import Path as PathParameter
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from pydantic import BaseModel, ConfigDict, Field

from services.api.body_limit import BodyLimit
from services.db.studies import StudyParticipant
from services.patterns import PRINTABLE
from services.web.study_store import StudyStore
from simcore.errors import InputError

MOST_BODY_BYTES = 16 * 1024
STATIC = Path(__file__).with_name("static")
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; form-action 'self'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}

router = APIRouter()


class NewParticipant(BaseModel):
    """What a participant says before starting."""

    model_config = ConfigDict(extra="forbid")

    experience: Literal["", "none", "some", "professional"] = ""


class NewAnswer(BaseModel):
    """One choice."""

    model_config = ConfigDict(extra="forbid")

    chosen: Literal["left", "right"]
    milliseconds: int = Field(default=0, ge=0, le=86_400_000)


class NotFoundError(Exception):
    """No such participant, question or picture."""


def create_study_app(store: StudyStore) -> FastAPI:
    """The application of one study.

    Args:
        store: the study.
    """
    app = FastAPI(title=f"Study: {store.study.name}", docs_url=None, redoc_url=None, openapi_url=None)
    app.state.store = store
    app.include_router(router)
    app.add_exception_handler(NotFoundError, _not_found)
    app.add_exception_handler(InputError, _bad_input)
    app.add_exception_handler(RequestValidationError, _not_valid)
    app.add_middleware(BodyLimit, limit=MOST_BODY_BYTES)
    app.mount("/static", StaticFiles(directory=STATIC), name="static")
    return app


def get_store(request: Request) -> StudyStore:
    """The study that is served."""
    store: StudyStore = request.app.state.store
    return store


Identifier = Annotated[str, PathParameter(max_length=80, pattern=PRINTABLE)]
Served = Annotated[StudyStore, Depends(get_store)]


def get_participant(participant_id: Identifier, store: Served) -> StudyParticipant:
    """The participant of the path.

    Raises:
        NotFoundError: nobody in this study.
    """
    participant = store.participant(participant_id)
    if participant is None:
        raise NotFoundError
    return participant


Asked = Annotated[StudyParticipant, Depends(get_participant)]


@router.get("/")
def page() -> FileResponse:
    """The one page."""
    return FileResponse(STATIC / "study.html", headers=_HEADERS)


@router.get("/study")
def study(store: Served) -> dict[str, Any]:
    """What participants see of the study before they begin."""
    return {"name": store.study.name, "questions": store.study.triplets, "fabrics": len(store.fabrics)}


@router.post("/participants", status_code=201)
def begin(body: NewParticipant, store: Served) -> dict[str, Any]:
    """A new participant."""
    participant = store.add_participant(experience=body.experience)
    return {"participant": participant.id, "questions": len(participant.questions)}


@router.get("/participants/{participant_id}")
def progress(participant: Asked, store: Served) -> dict[str, Any]:
    """How far a participant is."""
    answered = store.chosen(participant)
    total = len(participant.questions)
    return {
        "questions": total,
        "answered": len(answered),
        "next": next((k for k in range(total) if k not in answered), None),
    }


@router.get("/participants/{participant_id}/questions/{position}")
def question(participant: Asked, position: int, store: Served) -> dict[str, Any]:
    """What to show for one question, and what was chosen before."""
    reference, left, right, *repeats = _question(participant, position)
    chosen = store.chosen(participant).get(position)
    shown = zip(("reference", "left", "right"), (reference, left, right), repeats, strict=True)
    return {
        "position": position,
        "chosen": None if chosen is None else "left" if chosen == left else "right",
        **{side: [f"pictures/{p}" for p in store.pictures(place, repeat)] for side, place, repeat in shown},
    }


@router.put("/participants/{participant_id}/answers/{position}", status_code=204)
def answer(participant: Asked, position: int, body: NewAnswer, store: Served) -> Response:
    """Record one choice."""
    _, left, right, *_ = _question(participant, position)
    store.answer(participant, position, left if body.chosen == "left" else right, body.milliseconds)
    return Response(status_code=204)


@router.get("/pictures/{picture_id}")
def picture(picture_id: Identifier, store: Served) -> Response:
    """A picture of a fabric."""
    found = store.picture(picture_id)
    if found is None:
        raise NotFoundError
    media_type, content = found
    return Response(content, media_type=media_type, headers={**_HEADERS, "Cache-Control": "private, max-age=86400"})


def _question(participant: StudyParticipant, position: int) -> list[int]:
    if not 0 <= position < len(participant.questions):
        raise NotFoundError
    row: list[int] = participant.questions[position]
    return row


def _not_found(_request: Request, _error: Exception) -> JSONResponse:
    return JSONResponse({"code": "not_found", "title": "there is no such thing in this study"}, 404)


def _not_valid(_request: Request, error: Exception) -> JSONResponse:
    """Only where and why: what was sent is not sent back."""
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    place = "/".join(str(part) for part in first["loc"])
    return JSONResponse({"code": "validation_failed", "title": f"{place}: {first['msg']}"}, 422)


def _bad_input(_request: Request, error: Exception) -> JSONResponse:
    return JSONResponse({"code": getattr(error, "code", "bad_input"), "title": str(error)}, 422)
