"""Keys are looked at before bodies."""

from __future__ import annotations

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from services.api.auth import CALLER, identify
from services.api.problems import ProblemError, problem_response
from services.api.state import ServiceState
from services.db.engine import DATABASE_AWAY


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
            except DATABASE_AWAY:
                pass  # the route asks again, and its failure is answered as any other of the database
        await self._app(scope, receive, send)
