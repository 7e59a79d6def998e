"""Forms and queries hold what they may hold and nothing else, as JSON bodies do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args, get_origin

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute

from services.api.problems import ProblemError

TWICE = "given more than once: give it once"
FORMS = ("multipart/form-data", "application/x-www-form-urlencoded")


async def known_fields_only(request: Request) -> None:
    """A dependency of routes that take a form: a misspelt field, and all but the last of one that is given twice, would
    otherwise be passed over without a word.

    Raises:
        RequestValidationError: the form has fields that the route does not know, or twice what is no list.
        ProblemError: what was sent is no form.
    """
    sent = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if sent not in FORMS:
        detail = f"the body is {sent or 'of no stated kind'}: send a form with files, {FORMS[0]}"
        raise ProblemError(415, "media_type_unsupported", detail)
    route = request.scope["route"]
    assert isinstance(route, APIRoute)
    known = [field.alias for field in route.dependant.body_params]
    form = await request.form()  # read already, for the route's own parameters
    said = f"no field of this form: it takes {', '.join(known)}"
    _refuse("body", [name for name in dict.fromkeys(form) if name not in known], "extra_forbidden", said)
    once = [field.alias for field in route.dependant.body_params if not _is_list(field.field_info.annotation)]
    _refuse("body", [name for name in once if len(form.getlist(name)) > 1], "given_twice", TWICE)


async def known_parameters_only(request: Request) -> None:
    """The same of a query: a misspelt filter would list everything.

    Raises:
        RequestValidationError: the query has parameters that the route does not know, or one twice.
    """
    route = request.scope["route"]
    assert isinstance(route, APIRoute)
    known = [field.alias for field in route.dependant.query_params]
    said = f"no parameter of this query: it takes {', '.join(known)}"
    given = request.query_params
    _refuse("query", [name for name in dict.fromkeys(given) if name not in known], "extra_forbidden", said)
    once = [field.alias for field in route.dependant.query_params if not _is_list(field.field_info.annotation)]
    _refuse("query", [name for name in once if len(given.getlist(name)) > 1], "given_twice", TWICE)


def _refuse(where: str, names: Sequence[str], kind: str, why: str) -> None:
    if names:
        raise RequestValidationError([{"type": kind, "loc": (where, name), "msg": why} for name in names])


def _is_list(annotation: object) -> bool:
    """A field that may hold several; also one that may be left out."""
    return get_origin(annotation) is list or any(_is_list(part) for part in get_args(annotation))
