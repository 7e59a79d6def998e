"""``Idempotency-Key``: the same request again gives the same answer and does nothing twice.

The answer is stored in the transaction that makes what it speaks of, so there is no moment at which one exists without
the other. Only answers of success are kept: a refused request may be mended and sent again under its key.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from http import HTTPStatus
from typing import Annotated, Any

from fastapi import Header
from fastapi.responses import JSONResponse
from sqlalchemy import Delete, delete
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from services.api.auth import Caller
from services.api.problems import ProblemError
from services.db.base import utc_now
from services.db.engine import Database
from services.db.idempotency import IdempotencyRecord
from services.patterns import PRINTABLE

IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=200,
        pattern=PRINTABLE,
        description="Any printable text without spaces, unique to this request, such as a UUID. The same key with the "
        "same content gives the first answer again, with other content 422 `idempotency_key_reused`. Remembered for a "
        "day.",
        examples=["5f0c2f1e-6a55-4b6e-9d0e-0d6f4f7c1f11"],
    ),
]


@dataclass(frozen=True)
class Answer:
    """A JSON answer of success."""

    status: int
    body: dict[str, Any]
    headers: dict[str, str] = field(default_factory=dict)

    def response(self, *, replayed: bool = False) -> JSONResponse:
        """As sent."""
        extra = {"Idempotent-Replayed": "true"} if replayed else {}
        return JSONResponse(self.body, self.status, headers={**self.headers, **extra})


@dataclass(frozen=True)
class Once:
    """One request that is to take effect once.

    Attributes:
        database: where answers are remembered.
        caller: keys of different callers do not meet.
        key: the header; None when nothing is to be remembered.
        fingerprint: of what was asked, see :func:`fingerprint`.
        hours: how long an answer is remembered.
    """

    database: Database
    caller: Caller
    key: str | None
    fingerprint: str
    hours: float

    def earlier(self) -> JSONResponse | None:
        """The answer already given under this key, if any.

        Raises:
            ProblemError: 422 when the key was used for another request.
        """
        if self.key is None:
            return None
        with self.database.read() as session:
            return self._replay(session)

    def answer(self, make: Callable[[Session], Answer]) -> JSONResponse:
        """Make and remember the answer, unless it was given before.

        Args:
            make: does the work in the transaction it is given.

        Raises:
            ProblemError: 422 when the key was used for another request.
        """
        try:
            with self.database.write() as session:
                earlier = self._replay(session)
                if earlier is not None:
                    return earlier
                answer = make(session)
                if self.key is not None:
                    session.execute(self._forget(self.key))
                    session.add(self._record(self.key, answer))
            return answer.response()
        except (IntegrityError, ProblemError) as error:
            # The same request at the same moment was first; ours is undone. Without a key it is not about that.
            if isinstance(error, ProblemError) and error.status_code != HTTPStatus.CONFLICT:
                raise
            earlier = self.earlier()
            if earlier is None:
                raise
            return earlier

    def _replay(self, session: Session) -> JSONResponse | None:
        if self.key is None:
            return None
        record = session.get(IdempotencyRecord, (self.caller.key_id or "", self.key))
        if record is None or record.created_at < self._since():
            return None
        if record.fingerprint != self.fingerprint:
            detail = "this Idempotency-Key was used for another request: make a new key for each request"
            raise ProblemError(422, "idempotency_key_reused", detail)
        return Answer(record.status, record.body, record.headers).response(replayed=True)

    def _since(self) -> datetime:
        return utc_now() - timedelta(hours=self.hours)

    def _forget(self, key: str) -> Delete:
        """The answer of before the time that answers are remembered; those are swept away only now and then."""
        own = (IdempotencyRecord.caller == (self.caller.key_id or ""), IdempotencyRecord.key == key)
        return delete(IdempotencyRecord).where(*own, IdempotencyRecord.created_at < self._since())

    def _record(self, key: str, answer: Answer) -> IdempotencyRecord:
        return IdempotencyRecord(
            caller=self.caller.key_id or "",
            key=key,
            fingerprint=self.fingerprint,
            status=answer.status,
            headers=dict(answer.headers),
            body=answer.body,
        )


def fingerprint(route: str, content: Mapping[str, Any]) -> str:
    """Hash of what is asked, whatever the order of keys, the spacing or the multipart boundary.

    Args:
        route: method and path.
        content: JSON values, and bytes for files.
    """

    def plain(value: Any) -> Any:
        if isinstance(value, bytes):
            return {"sha256": hashlib.sha256(value).hexdigest()}
        raise TypeError(f"{type(value).__name__} has no fingerprint")

    text = json.dumps([route, content], sort_keys=True, default=plain)
    return hashlib.sha256(text.encode()).hexdigest()
