"""A set's ``captures.json``, read and changed by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from capture.capture_set import CAPTURES_FILE


def document(folder: Path) -> dict[str, Any]:
    """What the set says."""
    value: dict[str, Any] = json.loads((folder / CAPTURES_FILE).read_text())
    return value


def change(folder: Path, **keys: Any) -> None:
    """Let it say otherwise."""
    (folder / CAPTURES_FILE).write_text(json.dumps({**document(folder), **keys}))
