"""Pictures of one fabric that came over the wire, as a capture set."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from capture.capture_set import CaptureSet


def load_sent(folder: Path, document: str, pictures: Mapping[str, bytes]) -> CaptureSet:
    """The set, laid out in a folder; its pictures are not read yet.

    Args:
        folder: an empty one.
        document: the ``captures.json``.
        pictures: depth pictures by the file names that it has for them.

    Raises:
        InputError: the document does not describe a capture set.
    """
    from capture.capture_set import CaptureSet

    for name, content in pictures.items():
        (folder / name).write_bytes(content)
    (folder / "captures.json").write_text(document, encoding="utf-8")
    return CaptureSet.load(folder, read_pictures=False)
