"""Making, finding and revoking API keys; only a hash of the secret is kept.

A secret has 256 random bits, so a plain SHA-256 protects it: there is nothing to guess, and a slow password hash would
only slow the server.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import or_, select, update
from sqlalchemy.orm import Session

from services.api.scopes import ApiScope
from services.db.api_keys import ApiKey
from services.db.base import utc_now
from services.names import is_text
from simcore.errors import InputError

TOKEN = re.compile(r"dm_([0-9a-f]{12})_([A-Za-z0-9_-]{43})")
NOBODY = hashlib.sha256(b"").hexdigest()
"""Compared with when no key has the prefix, so that the time taken says nothing."""


@dataclass(frozen=True)
class NewKey:
    """A key just made; ``token`` is shown once and cannot be had again."""

    id: str
    name: str
    token: str
    scopes: tuple[ApiScope, ...]
    expires_at: datetime | None


@dataclass(frozen=True)
class KeyInfo:
    """What may be listed of a key."""

    id: str
    name: str
    prefix: str
    scopes: tuple[str, ...]
    created_at: str
    expires_at: str | None
    revoked_at: str | None
    last_used_at: str | None


def create_key(
    session: Session, name: str, scopes: Sequence[ApiScope], *, expires_after_days: float | None = None
) -> NewKey:
    """Make a key.

    Raises:
        InputError: no name, or a lifetime that is not positive.
    """
    if not 1 <= len(name) <= 80 or not is_text(name):
        raise InputError("a key needs a name of 1 to 80 characters that says who uses it", code="key_name")
    if expires_after_days is not None and not 0 < expires_after_days <= 36500:
        raise InputError("a key's lifetime is a positive number of days", code="key_lifetime")
    prefix, secret = secrets.token_hex(6), secrets.token_urlsafe(32)
    expires_at = utc_now() + timedelta(days=expires_after_days) if expires_after_days is not None else None
    key = ApiKey(
        name=name, prefix=prefix, secret_sha256=_hash(secret), scopes=[s.value for s in scopes], expires_at=expires_at
    )
    session.add(key)
    session.flush()
    return NewKey(key.id, name, f"dm_{prefix}_{secret}", tuple(scopes), expires_at)


def list_keys(session: Session) -> list[KeyInfo]:
    """All keys, oldest first, revoked ones too."""
    return [
        KeyInfo(
            key.id,
            key.name,
            f"dm_{key.prefix}",
            tuple(key.scopes),
            key.created_at.isoformat(),
            key.expires_at.isoformat() if key.expires_at else None,
            key.revoked_at.isoformat() if key.revoked_at else None,
            key.last_used_at.isoformat() if key.last_used_at else None,
        )
        for key in session.scalars(select(ApiKey).order_by(ApiKey.created_at, ApiKey.id))
    ]


def revoke_key(session: Session, name: str) -> str:
    """Revoke the key with this identifier or prefix; again does no harm.

    Returns:
        The key's identifier.

    Raises:
        InputError: no such key.
    """
    wanted = select(ApiKey).where(or_(ApiKey.id == name, ApiKey.prefix == name.removeprefix("dm_")))
    key = session.scalar(wanted) if is_text(name) else None
    if key is None:
        raise InputError(f"no API key {name!r}: 'drapemeter keys list' shows them", code="key_unknown")
    if key.revoked_at is None:
        key.revoked_at = utc_now()
    return key.id


def any_key(session: Session) -> bool:
    """Whether a key was ever made; from then on the server is never open again."""
    return session.scalar(select(ApiKey.id).limit(1)) is not None


def find_key(session: Session, token: str) -> ApiKey | None:
    """The valid key of a token, or None: malformed, unknown, revoked or expired all look alike."""
    match = TOKEN.fullmatch(token)
    if match is None:
        return None
    prefix, secret = match.groups()
    key = session.scalar(select(ApiKey).where(ApiKey.prefix == prefix))
    matches = hmac.compare_digest(key.secret_sha256 if key is not None else NOBODY, _hash(secret))
    if key is None or not matches or key.revoked_at is not None:
        return None
    if key.expires_at is not None and key.expires_at <= utc_now():
        return None
    return key


def note_use(session: Session, key_id: str) -> None:
    """Remember when a key was last used."""
    session.execute(update(ApiKey).where(ApiKey.id == key_id).values(last_used_at=utc_now()))


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()
