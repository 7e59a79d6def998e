"""Forms and queries hold what they may hold and nothing else, as JSON bodies do."""

from __future__ import annotations

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute

from services.api.problems import ProblemError

FORMS = ("multipart/form-data", "application/x-www-form-urlencoded")


async def known_fields_only(request: Request) -> None:
    """A dependency of routes that take a form: a misspelt field would otherwise be passed over without a word.

    Raises:
        RequestValidationError: the form has fields that the route does not know.
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
    unknown = [name for name in dict.fromkeys(form) if name not in known]
    if unknown:
        raise RequestValidationError(
            [{"type": "extra_forbidden", "loc": ("body", name), "msg": said} for name in unknown]
        )


async def known_parameters_only(request: Request) -> None:
    """The same of a query: a misspelt filter would list everything.

    Raises:
        RequestValidationError: the query has parameters that the route does not know.
    """
    route = request.scope["route"]
    assert isinstance(route, APIRoute)
    known = [field.alias for field in route.dependant.query_params]
    said = f"no parameter of this query: it takes {', '.join(known)}"
    unknown = [name for name in dict.fromkeys(request.query_params) if name not in known]
    if unknown:
        raise RequestValidationError(
            [{"type": "extra_forbidden", "loc": ("query", name), "msg": said} for name in unknown]
        )
