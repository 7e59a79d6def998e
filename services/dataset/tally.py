"""Which simulations of a sweep have been told of."""

from __future__ import annotations


class Tally:
    """Tells a simulation's first word from later ones: a shard whose worker is lost is done, and told of, again."""

    def __init__(self) -> None:
        self._told = bytearray()

    def is_new(self, simulation: int) -> bool:
        """Whether this simulation, by its number in the sweep, is told of for the first time; now it is told."""
        if simulation >= len(self._told):
            self._told.extend(bytes(simulation + 1 - len(self._told)))
        new = not self._told[simulation]
        self._told[simulation] = 1
        return new
