"""Errors as RFC 9457 problem documents with a stable ``code``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any
from urllib.parse import quote

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from sqlalchemy.exc import DataError
from starlette.exceptions import HTTPException
from starlette.routing import Match, Route

from renderer.atomic import NO_ROOM as DISK_FULL
from services.api.context import request_id
from services.db.engine import DATABASE_AWAY, is_full
from services.jobs.task import NO_ROOM
from simcore.errors import DrapemeterError, InputError, MissingResourceError

MEDIA_TYPE = "application/problem+json"
CODES: dict[int, str] = {
    400: "bad_request",
    401: "key_missing",
    403: "forbidden",
    404: "not_found",
    405: "method_not_allowed",
    413: "request_too_large",
    415: "media_type_unsupported",
    422: "validation_failed",
}
"""Codes of errors that the framework raises by itself."""
JSON_TYPE = re.compile(r"application/([a-z0-9.-]+\+)?json")
MOST_FIELDS = 100
"""Of what is wrong with a body, so much is told field by field."""
MISSING_RETRY_S = "60"
"""Something that the server should have is not there: somebody has to mend that first."""

log = structlog.get_logger("drapemeter.api")


class FieldError(BaseModel):
    """What is wrong with one field."""

    pointer: str = Field(
        description="Where, as path from the body, form, query, path or header.", examples=["body/density"]
    )
    code: str = Field(description="Kind of mistake, stable.", examples=["greater_than_equal"])
    detail: str = Field(description="For people.", examples=["Input should be greater than or equal to 0.005"])


class Problem(BaseModel):
    """An RFC 9457 problem; programs look at ``code``."""

    type: str = Field(examples=["urn:drapemeter:problem:validation_failed"])
    title: str = Field(examples=["Unprocessable Entity"])
    status: int = Field(examples=[422])
    code: str = Field(examples=["validation_failed"])
    detail: str = Field(examples=["body/density: Input should be greater than or equal to 0.005"])
    instance: str = Field(examples=["/v1/estimates"])
    request_id: str = Field(examples=["3f0c9a1b5d7e4f62"])
    errors: list[FieldError] | None = None


class ProblemError(HTTPException):
    """Raised by routes and middleware; becomes a problem document.

    Args:
        status: HTTP status.
        code: stable machine-readable kind.
        detail: what was wrong and how to mend it.
        headers: further headers, such as ``Retry-After``.
    """

    def __init__(self, status: int, code: str, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(status, detail, dict(headers) if headers else None)
        self.code = code


def problem_body(
    status: int, code: str, detail: str, instance: str, errors: Sequence[FieldError] | None = None
) -> dict[str, Any]:
    """The JSON of a problem."""
    problem = Problem(
        type=f"urn:drapemeter:problem:{code}",
        title=HTTPStatus(status).phrase,
        status=status,
        code=code,
        detail=_text(detail),
        instance=quote(instance),
        request_id=request_id(),
        errors=list(errors) if errors else None,
    )
    return problem.model_dump(mode="json", exclude_none=True)


def _text(said: str) -> str:
    """With escapes for half a character, which is no JSON."""
    return said.encode(errors="backslashreplace").decode()


def problem_response(
    status: int,
    code: str,
    detail: str,
    instance: str,
    *,
    headers: Mapping[str, str] | None = None,
    errors: Sequence[FieldError] | None = None,
) -> JSONResponse:
    """A problem as an answer."""
    body = problem_body(status, code, detail, instance, errors)
    return JSONResponse(body, status, headers=dict(headers) if headers else None, media_type=MEDIA_TYPE)


def install_problem_handlers(app: FastAPI) -> None:
    """Make every error of the application a problem document."""
    app.add_exception_handler(HTTPException, _on_http_error)
    app.add_exception_handler(RequestValidationError, _on_validation_error)
    app.add_exception_handler(DrapemeterError, _on_own_error)
    for away in DATABASE_AWAY:
        app.add_exception_handler(away, _on_database_error)
    app.add_exception_handler(DataError, _on_refused_data)
    app.add_exception_handler(Exception, _on_unforeseen)


async def _on_http_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    code = error.code if isinstance(error, ProblemError) else CODES.get(error.status_code, "http_error")
    headers, detail = dict(error.headers or {}), str(error.detail)
    cause = error.__cause__
    if isinstance(cause, OSError) and cause.errno in DISK_FULL:  # while an upload was read: no fault of who sent it
        log.error("no_room", error=str(cause))
        detail = "the service has no room for the upload: try again in a while"
        return problem_response(503, NO_ROOM, detail, request.url.path, headers={"Retry-After": MISSING_RETRY_S})
    if error.status_code == HTTPStatus.BAD_REQUEST and not isinstance(error, ProblemError):
        detail = f"the request cannot be read ({detail.rstrip('.')}): send well-formed JSON in UTF-8, or a whole form"
    if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        headers["Allow"] = ", ".join(_allowed(request))
    return problem_response(error.status_code, code, detail, request.url.path, headers=headers)


def _allowed(request: Request) -> list[str]:
    """All methods of a path; the framework knows those of the first route only."""
    routes: Sequence[Route] = request.app.state.api_routes
    path = next((route.path for route in routes if route.matches(request.scope)[0] is not Match.NONE), None)
    methods = {method for route in routes if route.path == path for method in route.methods or ()}
    return sorted(methods | {"HEAD"} if "GET" in methods else methods)


async def _on_validation_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    # Only place, kind and message: what was sent may be long, secret or no valid JSON.
    fields = [
        FieldError(pointer=_text("/".join(str(p) for p in e["loc"])), code=str(e["type"]), detail=str(e["msg"]))
        for e in error.errors()[:MOST_FIELDS]
    ]
    sent = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if [field.pointer for field in fields] == ["body"] and not JSON_TYPE.fullmatch(sent):
        detail = f"the body is {sent or 'of no stated kind'}: send JSON, with Content-Type: application/json"
        return problem_response(415, "media_type_unsupported", detail, request.url.path)
    first = fields[0] if fields else FieldError(pointer="body", code="invalid", detail="the request is not valid")
    others = len(error.errors()) - 1
    more = f" (and {others} more)" if others > 0 else ""
    detail = f"{first.pointer}: {first.detail}{more}"
    return problem_response(422, "validation_failed", detail, request.url.path, errors=fields)


async def _on_own_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, DrapemeterError)
    status = 422 if isinstance(error, InputError) else 503 if isinstance(error, MissingResourceError) else 500
    headers = {"Retry-After": MISSING_RETRY_S} if status == HTTPStatus.SERVICE_UNAVAILABLE else None
    return problem_response(status, error.code, str(error), request.url.path, headers=headers)


async def _on_database_error(request: Request, error: Exception) -> JSONResponse:
    log.error("database_failed", error=str(error))
    if is_full(error):
        detail = "the service has no room to store anything: try again in a while"
        return problem_response(503, NO_ROOM, detail, request.url.path, headers={"Retry-After": MISSING_RETRY_S})
    detail = "the database does not answer: try again in a moment"
    return problem_response(503, "database_unreachable", detail, request.url.path, headers={"Retry-After": "5"})


async def _on_refused_data(request: Request, error: Exception) -> JSONResponse:
    log.error("database_refused", error=str(error))
    detail = "a text or number is longer or larger than the database takes: shorten it"
    return problem_response(422, "validation_failed", detail, request.url.path)


async def _on_unforeseen(request: Request, error: Exception) -> JSONResponse:
    log.error("unforeseen_error", request_id=request_id(), exc_info=error)  # what else is bound is gone by now
    detail = f"the server failed in a way that nobody foresaw; its log has more under request {request_id()}"
    # it goes out above what sets these headers on every other answer
    headers = {"X-Request-ID": request_id(), "X-Content-Type-Options": "nosniff"}
    return problem_response(500, "internal_error", detail, request.url.path, headers=headers)
