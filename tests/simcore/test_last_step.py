"""What is near the tolerance after the last step that is allowed is judged, not taken for a saddle."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from simcore.batch.newton import BatchNewton
from simcore.newton import Newton, NewtonOptions

from .rigs import FABRICS, Array, Level, Rig, strip


@pytest.fixture(scope="module")
def level() -> Level:
    """A strip that its upper edge holds, without a panel."""
    level = strip(0.1, 0.2, 0.02)
    held = np.zeros((level.grid.rows, level.grid.columns), dtype=bool)
    held[0] = True
    Rig.of(level, FABRICS["medium"], held)
    return level


def flat(level: Level) -> Array:
    return level.grid.rest.copy()


def test_the_last_step_is_enough_where_it_ends_at_rest(level: Level) -> None:
    whole = Newton(level, NewtonOptions()).minimise(flat(level))
    assert whole.converged and whole.iterations > 0
    just = Newton(level, NewtonOptions(iterations=whole.iterations)).minimise(flat(level))
    assert just.converged and just.stable and just.iterations == whole.iterations
    assert just.x.tobytes() == whole.x.tobytes()
    short = Newton(level, NewtonOptions(iterations=whole.iterations - 1)).minimise(flat(level))
    assert not short.converged and short.residual >= NewtonOptions().tolerance


def test_a_saddle_after_the_last_step_is_one(level: Level, monkeypatch: pytest.MonkeyPatch) -> None:
    rest = Newton(level, NewtonOptions()).minimise(flat(level))
    asked: list[float] = []

    def negative(x: Array, blend: float, *_: object) -> int:
        asked.append(blend)
        return 1

    monkeypatch.setattr(level, "factor", negative)
    again = Newton(level, NewtonOptions(iterations=0)).minimise(rest.x)
    assert not again.converged and not again.stable and again.residual < NewtonOptions().tolerance
    assert asked == [1.0], "judged once by the exact Hessian, and not left"


class Resting:
    """In place of a batch's level: cloths that nothing moves, some of them at saddles."""

    most = 8

    def __init__(self, positive: list[bool]) -> None:
        self.positive = torch.tensor(positive)
        self.grid, self.weights = SimpleNamespace(hu=0.02, hv=0.02), torch.ones(len(positive))

    def gradients(self, which: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
        """None."""
        return torch.zeros_like(x)

    def energies(self, which: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
        """None."""
        return torch.zeros(len(which), dtype=x.dtype)

    def residuals(self, which: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
        """None."""
        return torch.zeros(len(which), dtype=gradient.dtype)

    def factor(self, which: torch.Tensor, *_: torch.Tensor) -> tuple[Any, torch.Tensor]:
        """Which Hessians are positive definite."""
        return None, self.positive[which]


def test_in_a_batch_too() -> None:
    level: Any = Resting([True, False, True])
    rest = BatchNewton(level, NewtonOptions(iterations=0)).minimise(torch.zeros((3, 1, 1, 3), dtype=torch.float64))
    assert rest.converged.tolist() == rest.stable.tolist() == [True, False, True]
    assert rest.residual.tolist() == [0.0] * 3 and rest.iterations.tolist() == [0] * 3
