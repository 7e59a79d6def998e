"""How firmly magnets hold, one amount for all fabrics: every explanation is averaged over it.

Between a magnet that holds a point of the cloth and one that holds a patch a soft fabric moves by millimetres, and much
as one does that stretches less. Granted to each fabric by itself that would hide such effects; the magnets are the same
for all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.inference.block import Block, View, whiten
from diagnosis.inference.evidence import Table

Array = NDArray[np.float64]
HOLDS = (0.0, 0.1, 0.2, 0.3, 0.45, 0.6)
"""Shares of the way from what the stated magnets hold to the other extreme; see :mod:`diagnosis.afresh.grip`."""
SPREAD = 0.2
"""Standard deviation of that share beforehand."""
SCENE = "stretch"
"""There it is looked for; in ``hanging`` errors are larger, and folds decide."""


def holds_of(blocks: Sequence[Block]) -> tuple[float, ...]:
    """The shares to average over: no other than the stated one where no block shows them."""
    shown = any(block.scene == SCENE and block.grip is not None and bool(np.any(block.grip)) for block in blocks)
    return HOLDS if shown else HOLDS[:1]


def held(block: Block, share: float) -> Block:
    """A block as if it had been simulated with magnets that hold so."""
    if block.scene != SCENE or share == 0.0 or block.grip is None:
        return block
    stated, wide = (_held(view, share * block.grip) for view in block.views)
    return replace(block, stated=stated, wide=wide)


def _held(view: View, change: Array) -> View:
    return replace(view, measured=view.measured - whiten(view, change[:, None])[:, 0])


def log_weights(holds: Sequence[float]) -> Array:
    """Log probabilities of shares beforehand, [holds]."""
    weight = -0.5 * (np.array(holds) / SPREAD) ** 2
    return np.asarray(weight - np.log(np.exp(weight).sum()))


def over_holds(same: Sequence[Table], weights: Array) -> Table:
    """Tables of one explanation, one for each of some shares with these log weights, as one with all their rows."""
    return replace(
        same[0],
        blocks=tuple(np.concatenate(rows) for rows in zip(*(table.blocks for table in same), strict=True)),
        pixels=np.concatenate([table.pixels for table in same]),
        prior=np.concatenate([table.prior for table in same]),
        sizes=tuple(size for table in same for size in table.sizes),
        hold=np.concatenate(
            [table.hold + np.full(len(table.sizes), w) for table, w in zip(same, weights, strict=True)]
        ),
    )


def tried_with_two(found: Sequence[Sequence[float]], weights: Array) -> list[int]:
    """Numbers of the shares that two effects are tried with: the most probable one, and as stated.

    Where magnets that hold otherwise hide one effect of two, these look the most probable before both are tried.

    Args:
        found: for each share the log evidence of every explanation, its own probability included.
        weights: log weight of each share.
    """
    best = int(np.argmax(logsumexp(np.array(found), axis=1) + weights))
    return [best] if best == 0 else [best, 0]
