"""What an explanation leaves over that is common to all fabrics: the mark of something outside the catalogue.

What is in no catalogue cannot be simulated, but the change it brings can be put together from changes that can:
effects, parameters, pins, warps of the picture and smooth changes of any form, in the same proportions for all
fabrics. Such a mixture is fitted to all fabrics but one and judged on the one left out; what is chance, or one
fabric's own, predicts nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.block import Block, whiten
from diagnosis.effect import Effect
from diagnosis.effects import get_effect
from diagnosis.evidence import smooth_modes
from diagnosis.likelihood import ALONE_NATS, LikelihoodModel
from diagnosis.sizes import node_values

Array = NDArray[np.float64]
WEIGHTS = (0.2, 0.4)
"""Spread of a mixture's proportions, 1 being what follows: smaller ones find how simulators differ for no reason."""
PARAMETER_SIGMAS, PIN_M, SMOOTH_M = 3.0, 0.003, 0.003
"""Of a change of each parameter, of each pin along each axis, of each smooth form; effects: their typical size;
warped pictures: :data:`diagnosis.warps.WARP`."""
ROUNDS = 6
LEAST_SQUARE = 0.3
"""A block that is fitted better than this share of its errors counts no more for it."""


@dataclass(frozen=True)
class Mixture:
    """Changes of all fabrics, in units of their errors.

    Attributes:
        blocks: what was measured.
        columns: of each block, a row for each change, [k, n].
        grams: their products with each other, [k, k].
        model: of the likelihood.
    """

    blocks: tuple[Block, ...]
    columns: tuple[Array, ...]
    grams: tuple[Array, ...]
    model: LikelihoodModel

    @classmethod
    def of(cls, effects: Sequence[str], blocks: Sequence[Block], model: LikelihoodModel) -> Mixture:
        """Of the catalogue's effects and what is not in it."""
        usable = [e for e in map(get_effect, effects) if not (e.random_repeats or e.holds or e.white)]
        pins = {
            scene: {len(block.pins) for block in blocks if block.scene == scene}
            for scene in sorted({block.scene for block in blocks})
        }
        columns = tuple(_columns(usable, block, pins) for block in blocks)
        return cls(tuple(blocks), columns, tuple(rows @ rows.T for rows in columns), model)

    def gain(self, left: Sequence[Array], granted: Sequence[Array] | None = None) -> float:
        """Log likelihood of each fabric by a mixture fitted on the others, over that without; blocks as they count.

        Args:
            left: of each block, what an explanation leaves, whitened, [n].
            granted: of each block, changes that count for nothing, [rows, n]: how the explanation itself would change
                with its size, which may be fitted too small or too large.

        Returns:
            The best of :data:`WEIGHTS`; nothing (-inf) for a single fabric.
        """
        fabrics = sorted({block.fabric for block in self.blocks})
        if len(fabrics) < 2:
            return -np.inf
        if granted is not None:
            bases = [_basis(rows) for rows in granted]
            beyond = [own - basis @ (basis.T @ own) for own, basis in zip(left, bases, strict=True)]
            return self._beyond(bases).gain(beyond)
        return max(self._gain(left, fabrics, weight) for weight in WEIGHTS)

    def _beyond(self, bases: Sequence[Array]) -> Mixture:
        """Without what each block's orthonormal columns span."""
        along = [rows @ basis for rows, basis in zip(self.columns, bases, strict=True)]
        columns = [r - a @ b.T for r, a, b in zip(self.columns, along, bases, strict=True)]
        grams = [gram - a @ a.T for gram, a in zip(self.grams, along, strict=True)]
        return replace(self, columns=tuple(columns), grams=tuple(grams))

    def _gain(self, left: Sequence[Array], fabrics: Sequence[str], weight: float) -> float:
        products = [rows @ own for rows, own in zip(self.columns, left, strict=True)]
        squares = [float(own @ own) for own in left]
        count = [len(own) for own in left]

        def remaining(share: Array, n: int) -> float:
            return max(0.0, squares[n] - 2 * float(share @ products[n]) + float(share @ self.grams[n] @ share))

        gains = []
        for fabric in fabrics:
            seen = [n for n, block in enumerate(self.blocks) if block.fabric != fabric]
            share = np.zeros(len(products[0]), dtype=np.float64)
            for _ in range(ROUNDS):
                precision = np.eye(len(share)) / weight**2
                right = np.zeros(len(share))
                for n in seen:
                    heard = self.model.dimension_share / max(remaining(share, n) / count[n], LEAST_SQUARE)
                    precision += heard * self.grams[n]
                    right += heard * products[n]
                share = np.asarray(np.linalg.solve(precision, right), dtype=np.float64)
            held = [n for n, block in enumerate(self.blocks) if block.fabric == fabric]
            gains.append(sum(self._counted(remaining(share, n), squares[n], n, count[n]) for n in held))
        gains.sort()
        return float(sum(gains) - max(0.0, gains[-1] - max(gains[-2], 0.0) - ALONE_NATS))

    def _counted(self, after: float, before: float, number: int, count: int) -> float:
        """Gain of one block from its squared residual after and before."""
        share, scene = self.model.dimension_share, self.blocks[number].scene
        now, then = self.model.log_density(np.array([after, before]) * share, count * share, scene)
        return float(self.model.counted(now - then, scene))


def _basis(rows: Array) -> Array:
    """Orthonormal columns that span the rows, [n, rank]."""
    _, size, basis = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(basis[size > 1e-9 * max(float(size.max(initial=0.0)), 1e-9)].T)


def _columns(effects: Sequence[Effect], block: Block, pins: Mapping[str, Set[int]]) -> Array:
    """Of one block; ``pins``: by scene, how many rows its blocks have for their pins (left out where they differ)."""
    view = block.stated
    rows = [_typical(effect, view.responses) for effect in effects]
    rows += [whiten(view, PARAMETER_SIGMAS * block.jacobian.T).T, whiten(view, block.warps.T).T]
    for scene, counts in pins.items():  # another placement, other proportions
        own = scene == block.scene
        if len(counts) == 1:
            moved = whiten(view, PIN_M * block.pins.T).T
            rows.append(moved if own else np.zeros((*counts, len(view.measured))))
        smooth = whiten(view, SMOOTH_M * smooth_modes()[block.cell]).T
        rows.append(smooth if own else np.zeros_like(smooth))
    return np.concatenate(rows)


def _typical(effect: Effect, responses: Mapping[str, Array]) -> Array:
    """Response at a size in the middle of the prior, for each component and place."""
    known = responses[effect.name]
    if effect.vector:
        return known[: len(effect.components)]
    size = np.abs(node_values(effect))
    middle = int(np.argmin(np.abs(size - np.median(size))))
    return known[[place * len(size) + middle for place in range(len(effect.places))]]
