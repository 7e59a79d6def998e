"""What captures that had no part in finding effects say against them."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from diagnosis.cause import Cause
from diagnosis.effects import get_effect
from diagnosis.fresh import is_mechanical
from diagnosis.report import Shrinkage
from diagnosis.shares import fraction_of
from diagnosis.shrinkage import Measured

WORSE = -0.25
"""An effect that closes less than this share of the gap is none of it: of six in 300 sealed cases five were wrong."""
NEEDED = 0.9
"""A second effect leaves less than this share of what the first alone leaves, or it is not needed."""


class Measure(Protocol):
    """How far the gap shrinks with what is named; ``known``: names are not sought again without what is held out."""

    def __call__(self, of: Cause, *, known: bool = False) -> Measured | None: ...


def judged(cause: Cause, measure: Measure) -> tuple[Cause, Measured | None]:
    """What held-out captures leave of a cause, with the shrinkage by what is then named.

    Effects that take simulations away from captures are refuted; of two together, one may stay. A second effect on the
    cloth with which the simulations come hardly nearer than with the first alone is refuted too.
    """
    measured = measure(cause)
    if measured is not None and len(cause.named) == 2:
        single = cause.refuted()
        if is_refuted(measured):
            cause, measured = single, measure(single)
        elif set(single.named) & set(cause.named) and all(is_mechanical(get_effect(n)) for n in cause.named):
            both, alone = measure(cause, known=True), measure(single, known=True)
            if both is not None and alone is not None and is_needless(both.shrinkage, alone.shrinkage):
                cause, measured = single, measure(single)
    while measured is not None and is_refuted(measured):  # ends: none and unknown get what effects lose
        cause = cause.refuted()
        measured = measure(cause) if cause.named else None
    return cause, measured


def is_refuted(measured: Measured) -> bool:
    """Simulated afresh on fabrics that had no part in finding it, the effect plainly takes the simulation away.

    Of three fabrics or more the one that speaks most against it does not decide alone: its folds may have been missed
    with the effect on.
    """
    found = measured.shrinkage
    if not found.simulated_afresh or found.fraction >= WORSE:
        return False
    against: dict[str, float] = {}
    for held in measured.held:
        before, after = held.squares[-1][:2]
        against[held.block.fabric] = against.get(held.block.fabric, 0.0) + float(after - before)
    if len(against) < 3:
        return True
    most = max(against, key=lambda fabric: against[fabric])
    others = np.stack([held.squares[-1] for held in measured.held if held.block.fabric != most])
    return fraction_of(others) <= 0.0


def is_needless(together: Shrinkage, alone: Shrinkage) -> bool:
    """Simulated afresh on held-out captures, two effects leave about as much as one of them."""
    return together.simulated_afresh and alone.simulated_afresh and together.after > NEEDED * alone.after
