"""How far a diagnosis is, told to whoever waits for it."""

from __future__ import annotations

from collections.abc import Callable

Told = Callable[[float, str], None]
"""Is given what is done, from 0 to 1, and what comes now, in words."""

FIRST_LOOK = 0.4
"""So far it is when each fabric had its first look; what share of the time that takes differs from set to set."""
LOOKS = 10
"""Closer looks of one round; the shrinkage is measured after them."""


class Steps:
    """Counts what is done; what is told never goes back, though a diagnosis may begin its looks once more.

    Args:
        told: who is told; None: nobody.
        fabrics: how many there are.
        rounds: how many there may be.
    """

    def __init__(self, told: Told | None = None, fabrics: int = 0, rounds: int = 1) -> None:
        self._told = told
        self._rounds, self._round = rounds, 0
        self._fabrics, self._explained = fabrics, 0
        self._done = 0.0

    def begin(self) -> None:
        """Nothing is done yet."""
        self._tell(0.0, f"0 of {self._fabrics} fabrics")

    def fabric(self, count: float = 1.0) -> None:
        """So many more fabrics had their first look."""
        self._explained += round(count)
        share = min(self._explained / max(self._fabrics, 1), 1.0)
        self._tell(FIRST_LOOK * share, f"{min(self._explained, self._fabrics)} of {self._fabrics} fabrics")

    def look(self, number: int) -> None:
        """This one of the closer looks, from 1, begins."""
        self._tell(FIRST_LOOK + (1.0 - FIRST_LOOK) * (number - 1) / (LOOKS + 1), f"closer look {number} of {LOOKS}")

    def measure(self) -> None:
        """The shrinkage is measured."""
        self._tell(1.0 - (1.0 - FIRST_LOOK) / (LOOKS + 1), "how far the gap shrinks")

    def again(self) -> None:
        """A round is done, and there is one more, with other estimates."""
        self._round += 1
        self._tell(0.0, "parameters estimated again")

    def _tell(self, done: float, what: str) -> None:
        if self._told is not None:
            self._done = max(self._done, (self._round + done) / self._rounds)
            self._told(self._done, what)


UNTOLD = Steps()
"""Nobody waits."""
