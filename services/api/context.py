"""The request's identifier, wherever in its handling one is."""

from __future__ import annotations

from contextvars import ContextVar

_request_id: ContextVar[str] = ContextVar("request_id", default="")


def request_id() -> str:
    """Identifier of the request being handled; empty outside one."""
    return _request_id.get()


def set_request_id(value: str) -> None:
    """Called once a request by the middleware."""
    _request_id.set(value)
