"""Cursors: opaque marks of where a page ended; rows added meanwhile neither repeat nor hide others."""

from __future__ import annotations

import base64
import binascii
from typing import Annotated

from fastapi import Query

from services.api.problems import ProblemError

Limit = Annotated[int, Query(ge=1, le=200, description="Items a page.")]
Cursor = Annotated[str | None, Query(max_length=64, description="`next_cursor` of the page before.")]


def encode_cursor(number: int) -> str:
    """Cursor after the row of this number."""
    return base64.urlsafe_b64encode(f"after:{number}".encode()).decode().rstrip("=")


def decode_cursor(cursor: str | None) -> int:
    """Number of the last row of the page before; 0 for the first page.

    Raises:
        ProblemError: 422 when it is no cursor of ours.
    """
    if cursor is None:
        return 0
    try:
        text = base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)).decode("ascii")
    except (binascii.Error, ValueError):
        text = ""
    number = text.removeprefix("after:")
    if not text.startswith("after:") or not (number.isascii() and number.isdigit() and len(number) <= 10):
        raise ProblemError(422, "cursor_invalid", "this is no cursor: take next_cursor from the page before, or none")
    return min(int(number), 2**31 - 1)
