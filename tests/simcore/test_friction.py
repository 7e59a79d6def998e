"""Rounds in which friction's bounds are taken anew."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simcore import friction
from simcore.newton import NewtonOptions, Rest

from .rigs import Array

REST = Rest(np.zeros((1, 1, 3)), 0.0, True, 1, True)


@dataclass(frozen=True)
class Pressing:
    """In place of contact with a panel: what presses changes with each round until one, and no more."""

    until: int
    friction_force: Array

    def normal_force(self, x: Array, fixed: Array) -> Array:
        """After as many rounds as the positions say."""
        return np.array([2.0 ** min(float(x[0, 0, 0]), self.until)])


@pytest.mark.parametrize(
    ("until", "rounds", "settled"),
    [(0, 1, True), (3, 4, True), (friction.ROUNDS - 1, friction.ROUNDS, True), (20, friction.ROUNDS, False)],
)
def test_the_last_round_is_judged_too(until: int, rounds: int, settled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def newton(*_: object) -> Any:
        """One more round each time."""
        return SimpleNamespace(minimise=lambda x: Rest(x + 1.0, 0.0, True, 1, True))

    monkeypatch.setattr(friction, "Newton", newton)
    level: Any = SimpleNamespace(contact=Pressing(until, np.array([0.5])), fixed=None)
    level.touch = lambda contact: setattr(level, "contact", contact)
    rest = friction.settle(level, REST, 1.0, NewtonOptions(), 0.0)
    assert (rest.converged, rest.iterations) == (settled, 1 + rounds)
