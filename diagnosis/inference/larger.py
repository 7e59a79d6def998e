"""Captures that differ from their simulations by more than simulators differ where nothing is there.

What is in no catalogue need not look alike in all fabrics, nor like anything that can be put together from known
changes. It still makes most fabrics differ more. By how much they may differ was taken from sealed cases without an
effect: their errors are still smaller than the noise model allows for, so that model alone sees nothing in them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from diagnosis.inference.block import Block
from diagnosis.inference.said_again import is_said_again

CALM, PLAIN = 0.8, 2.2
"""Mean squares of whitened residuals. Of 23 opened sets of version 40's check with nothing in them or a wrong
parameter 15 lie below the first, none above 1.7, with nothing in them 1.24; six of version 39's are below 0.4."""
MUCH = 1.25
"""Mean square above which what is named leaves enough for more to be simulated: no set with nothing in it has more."""
MOST_SENSED = 0.8
"""A fabric whose errors are the noise of pixels to this share tells nothing else."""
CALM_NATS, PLAIN_NATS = -4.0, 3.0
"""Log odds for something larger at these; linear in the logarithm between, and no more beyond them."""


def usual_square(blocks: Sequence[Block]) -> float | None:
    """Mean square of a fabric's whitened residuals in ``stretch``, the (lower) median of all fabrics.

    What the noise of pixels makes of it is not counted: that is as large as modelled, all else half as large. One
    fabric of several may have wrong parameters or other folds. In units of the usual errors, whichever the blocks were
    whitened by. None where fewer than two were seen.
    """
    chosen = [b for b in blocks if b.scene == "stretch" and b.sensed < MOST_SENSED]
    squares = [
        max(0.0, float(np.mean(b.stated.measured**2)) - b.sensed) / (1.0 - b.sensed) / b.calm_square for b in chosen
    ]
    return float(np.quantile(squares, 0.5, method="lower")) if len(squares) > 1 else None


def larger_nats(square: float) -> float:
    """Log odds that so large a mean square is more than simulators differ by for no reason."""
    way = np.log(max(square, CALM) / CALM) / np.log(PLAIN / CALM)
    return float(CALM_NATS + min(1.0, way) * (PLAIN_NATS - CALM_NATS))


def larger_than_chance(
    ways: Iterable[Sequence[Block]], said: Iterable[tuple[float, Sequence[Sequence[Block]] | None]]
) -> float:
    """Log evidence of something that makes most fabrics differ more, over that of nothing.

    Args:
        ways: the blocks as they are, one way or several in which magnets may hold: the calmest counts.
        said: of effects, what they gain over nothing and the blocks without them, in each of these ways; None where
            they explain any scatter.
    """
    alone = min(map(_nats, ways))
    found = alone
    for gained, left in said:
        still = CALM_NATS if left is None else min(map(_nats, left))
        if is_said_again(alone, still, gained):
            found = min(found, gained + still)
    return found


def _nats(blocks: Sequence[Block]) -> float:
    """Log odds by these blocks; nothing larger (-inf) where too few fabrics were seen."""
    square = usual_square(blocks)
    return -np.inf if square is None else larger_nats(square)
