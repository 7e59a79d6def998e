"""How long a request may be."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from services.api.problems import ProblemError, problem_response

PLAIN_BODY_BYTES = 1024 * 1024
"""Most of a body that is no upload: more than any that the interface takes."""


class BodyLimit:
    """Refuses bodies that are too long, announced or not.

    Args:
        app: what it stands before.
        limit: of uploads (multipart) [bytes].
        plain_limit: of every other body, which is parsed at once [bytes].
    """

    def __init__(self, app: ASGIApp, limit: int, plain_limit: int | None = None) -> None:
        self._app = app
        self._limit = limit
        self._plain_limit = limit if plain_limit is None else min(limit, plain_limit)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        uploads = headers.get("content-type", "").lower().startswith("multipart/")
        limit = self._limit if uploads else self._plain_limit
        instead = "fewer or smaller pictures" if uploads else "less, or files as a form"
        detail = f"the request is longer than {limit} bytes: send {instead}"
        announced = headers.get("content-length", "0")
        if announced.isdigit() and int(announced) > limit:
            response = problem_response(413, "request_too_large", detail, scope["path"])
            await response(scope, receive, send)
            return
        seen = 0

        async def counted() -> Message:
            nonlocal seen
            message = await receive()
            seen += len(message.get("body", b""))
            if seen > limit:
                raise ProblemError(413, "request_too_large", detail)
            return message

        await self._app(scope, counted, send)
