"""What speaks against the poses that a fabric's captures were seen with, gathered as the captures go by."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from capture.prepare import PreparedCapture
from capture.report import pose_doubts


class PoseNotes:
    """Hears captures, none of which it keeps, and tells of each fabric what speaks against their poses."""

    def __init__(self) -> None:
        self._captures: dict[str, dict[str, list[str]]] = {}

    def heard(self, prepared: Iterable[PreparedCapture]) -> Iterator[PreparedCapture]:
        """The same captures one by one; what is to be said of one is known once it is handed on."""
        for one in prepared:
            own = self._captures.setdefault(one.capture.fabric.id, {})
            for doubt in pose_doubts(one.registration):
                own.setdefault(doubt, []).append(one.capture.id)
            yield one

    def of_fabric(self, fabric: str) -> tuple[str, ...]:
        """In words, each doubt once, with the captures that it holds of; empty where there is none."""
        return tuple(
            f"capture {', '.join(captures)}: {doubt}" for doubt, captures in self._captures.get(fabric, {}).items()
        )
