"""Who asks, and whether they may."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import Depends, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from fastapi.security.utils import get_authorization_scheme_param

from services.api.keys import any_key, find_key, note_use
from services.api.problems import ProblemError
from services.api.scopes import ApiScope
from services.api.state import ServiceState, get_state
from services.db.base import utc_now
from services.db.engine import DATABASE_AWAY

CALLER = "drapemeter.caller"
"""Where the middleware leaves the caller in a request's scope."""
PASSED_ON = frozenset({"forwarded", "via", "x-forwarded-for", "x-forwarded-host", "x-forwarded-proto", "x-real-ip"})
"""Headers by which a proxy says that it asks for somebody else."""
NOTE_USE_EVERY = timedelta(minutes=1)

bearer = HTTPBearer(
    auto_error=False,
    scheme_name="ApiKey",
    description="`Authorization: Bearer dm_...`, made by `drapemeter keys create`. "
    "A server on loopback without any key is open.",
)


@dataclass(frozen=True)
class Caller:
    """Who asks.

    Attributes:
        key_id: the API key; None on an open server.
        scopes: what it may do.
    """

    key_id: str | None
    scopes: frozenset[ApiScope]

    def may(self, scope: ApiScope) -> bool:
        """Whether a permission is there."""
        return scope in self.scopes

    def owns(self, owner: str | None) -> bool:
        """Whether something was made by this caller."""
        return self.key_id is None or self.key_id == owner


EVERYBODY = Caller(None, frozenset(ApiScope))
"""The caller on an open server."""


def get_caller(
    request: Request,
    state: Annotated[ServiceState, Depends(get_state)],
    _: Annotated[HTTPAuthorizationCredentials | None, Security(bearer)],
) -> Caller:
    """The caller of a request, whom the middleware has found already.

    Raises:
        ProblemError: 401 when a key is needed and none, or no valid one, is there.
    """
    found: Caller | None = request.scope.get(CALLER)
    return identify(request, state) if found is None else found


def identify(request: Request, state: ServiceState) -> Caller:
    """Who sends a request, by its headers alone.

    Raises:
        ProblemError: 401 when a key is needed and none, or no valid one, is there.
    """
    challenge = {"WWW-Authenticate": "Bearer"}
    scheme, token = get_authorization_scheme_param(request.headers.get("authorization"))
    with state.database.read() as session:
        if scheme.lower() != "bearer" or not token:
            if "authorization" in request.headers:
                raise ProblemError(401, "key_invalid", "send the key as 'Authorization: Bearer dm_...'", challenge)
            if not state.settings.guarded and not any_key(session):
                refuse_browsers(request)
                return EVERYBODY
            detail = (
                "an API key is needed: 'drapemeter keys create' makes one; send it as 'Authorization: Bearer dm_...'"
            )
            raise ProblemError(401, "key_missing", detail, challenge)
        key = find_key(session, token)
    if key is None:
        raise ProblemError(
            401, "key_invalid", "the API key is unknown, revoked or expired: ask for a new one", challenge
        )
    if key.last_used_at is None or utc_now() - key.last_used_at > NOTE_USE_EVERY:
        with suppress(*DATABASE_AWAY), state.database.write() as session:  # who only reads needs no writing
            note_use(session, key.id)
    known = {scope.value for scope in ApiScope}
    return Caller(key.id, frozenset(ApiScope(name) for name in key.scopes if name in known))


def refuse_browsers(request: Request) -> None:
    """On an open server, refuse what a foreign web page in the user's browser could have sent.

    A page can reach a server on loopback by a name that it controls (DNS rebinding) or by a form (forgery); both show
    in the headers that a browser always sends. So does most of what a proxy passes on from other machines.

    Raises:
        ProblemError: 403.
    """
    host, origin = request.headers.get("host", ""), request.headers.get("origin")
    passed_on = not PASSED_ON.isdisjoint(request.headers)
    if _is_loopback(host) and _is_of(host, origin) and not passed_on:
        return
    detail = (
        "without API keys the server answers programs on this machine only: address it as http://127.0.0.1, or make a "
        "key with 'drapemeter keys create' (behind a proxy start it with DRAPEMETER_ENVIRONMENT=production)"
    )
    raise ProblemError(403, "origin_refused", detail)


def _is_loopback(host: str) -> bool:
    """Whether a Host header names this machine."""
    name = re.sub(r":\d+$", "", host).strip("[]")
    try:
        return name == "localhost" or ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def _is_of(host: str, origin: str | None) -> bool:
    """Whether an Origin header, if there is one, names the same host as a Host header."""
    try:
        return origin is None or urlsplit(origin).netloc == host
    except ValueError:  # no URL
        return False


def require(scope: ApiScope) -> Callable[..., Caller]:
    """A dependency that lets only callers with a permission through.

    Raises:
        ProblemError: 403 when the key lacks it.
    """

    def check(caller: Annotated[Caller, Depends(get_caller)]) -> Caller:
        if not caller.may(scope):
            raise ProblemError(403, "scope_missing", f"the API key lacks the scope {scope.value}")
        return caller

    return check
