"""What held-out captures say against an effect that was named."""

from __future__ import annotations

import pytest

from diagnosis.report import Shrinkage
from diagnosis.shrinkage import WORSE, is_refuted


def shrinkage(fraction: float, high: float, *, afresh: bool = True) -> Shrinkage:
    return Shrinkage(
        held_out=("f1-stretch-0",),
        before=1.0,
        after=1.0 - 0.5 * fraction,
        noise_floor=0.5,
        fraction=fraction,
        interval_90=(-1.0, high),
        simulated_afresh=afresh,
    )


@pytest.mark.parametrize("high", [0.2, 1.0])
def test_an_effect_that_takes_held_out_simulations_away_is_refuted_however_few_fabrics_say_so(high: float) -> None:
    """Of few fabrics the interval is as wide as it can be; it says nothing either way."""
    assert is_refuted(shrinkage(WORSE - 0.01, high))


def test_an_effect_that_closes_nothing_is_not_refuted() -> None:
    """Folds that were not found leave a true effect with nothing closed; they seldom leave the simulation farther."""
    assert not is_refuted(shrinkage(0.0, 0.3))
    assert not is_refuted(shrinkage(WORSE + 0.01, 1.0))


def test_known_responses_alone_refute_nothing() -> None:
    assert not is_refuted(shrinkage(-1.0, 0.0, afresh=False))
