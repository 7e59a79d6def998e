"""Files that go with a job."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FileContent:
    """A file that a job needs or leaves."""

    name: str
    media_type: str
    content: bytes
