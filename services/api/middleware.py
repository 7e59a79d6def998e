"""What happens to every request before its body is read: identifier, log line and metrics; size; key."""

from __future__ import annotations

import re
import secrets
import time

import structlog
from sqlalchemy.exc import DBAPIError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from services.api.auth import CALLER, identify
from services.api.context import set_request_id
from services.api.metrics import Metrics
from services.api.problems import ProblemError, problem_response
from services.api.state import ServiceState

ACCEPTABLE_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")

PLAIN_BODY_BYTES = 1024 * 1024
"""Most of a body that is no upload; the longest that the interface takes is a tenth of it."""

log = structlog.get_logger("drapemeter.access")


class RequestRecord:
    """Gives each request an identifier (or keeps the caller's), logs it and counts it."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope).get("x-request-id", "")
        identifier = given if ACCEPTABLE_ID.fullmatch(given) else secrets.token_hex(8)
        set_request_id(identifier)
        structlog.contextvars.bind_contextvars(request_id=identifier)
        started, status = time.perf_counter(), 500

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                headers["X-Request-ID"] = identifier
                headers["X-Content-Type-Options"] = "nosniff"
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        finally:
            seconds = time.perf_counter() - started
            route = getattr(scope.get("route"), "path", "unmatched")
            self._metrics.observe_request(scope["method"], route, status, seconds)
            log.info(
                "request",
                method=scope["method"],
                path=scope["path"],
                status=status,
                milliseconds=round(1e3 * seconds, 1),
            )
            structlog.contextvars.clear_contextvars()


class KeyFirst:
    """Refuses who may not ask before a byte of the body is read, let alone parsed."""

    def __init__(self, app: ASGIApp, state: ServiceState) -> None:
        self._app = app
        self._state = state

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"].startswith("/v1/"):
            try:
                scope[CALLER] = await run_in_threadpool(identify, Request(scope), self._state)
            except ProblemError as error:
                headers = dict(error.headers or {})
                response = problem_response(error.status_code, error.code, error.detail, scope["path"], headers=headers)
                await response(scope, receive, send)
                return
            except DBAPIError:
                pass  # the route asks again, and its failure is answered as any other of the database
        await self._app(scope, receive, send)


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
        detail = f"the request is longer than {limit} bytes: send {'fewer or smaller pictures' if uploads else 'less'}"
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
