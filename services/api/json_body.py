"""JSON bodies hold each key of an object once, as files and forms do: else all but the last would be passed over."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from starlette.exceptions import HTTPException

from services.api.forms import TWICE

Pairs = list[tuple[str, Any]]


class JsonRoute(APIRoute):
    """A route that takes JSON: give it to a router as ``route_class``."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """See :class:`fastapi.routing.APIRoute`.

        Raises:
            RequestValidationError: from the handler, of a body with a key twice in one object.
        """
        handle = super().get_route_handler()

        async def handle_json(request: Request) -> Response:
            try:
                return await handle(_JsonRequest(request.scope, request.receive))
            except HTTPException as error:
                if isinstance(error.__cause__, RequestValidationError):  # to the framework a body that cannot be read
                    raise error.__cause__ from None
                raise

        return handle_json


class _JsonRequest(Request):
    async def json(self) -> Any:
        """See :class:`starlette.requests.Request`."""
        twice: list[_Twice] = []

        def read(pairs: Pairs) -> dict[str, Any]:
            found = dict(pairs)
            if len(found) == len(pairs):
                return found
            twice.append(_Twice(pairs))
            return twice[-1]

        body = json.loads(await self.body(), object_pairs_hook=read)
        if twice:
            raise RequestValidationError([{"type": "given_twice", "loc": _first_twice(body, ("body",)), "msg": TWICE}])
        return body


class _Twice(dict[str, Any]):
    """An object with ``key`` in it twice."""

    def __init__(self, pairs: Pairs) -> None:
        super().__init__(pairs)
        self.key = next(key for key, times in Counter(key for key, _ in pairs).items() if times > 1)


def _first_twice(value: Any, place: tuple[str | int, ...]) -> tuple[str | int, ...] | None:
    """Where in a parsed body the first key is that is given twice, or None."""
    if isinstance(value, _Twice):
        return (*place, value.key)
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return next((found for key, item in children if (found := _first_twice(item, (*place, key))) is not None), None)
