"""Forms hold what they may hold and nothing else, as JSON bodies do."""

from __future__ import annotations

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute


async def known_fields_only(request: Request) -> None:
    """A dependency of routes that take a form: a misspelt field would otherwise be passed over without a word.

    Raises:
        RequestValidationError: the form has fields that the route does not know.
    """
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
