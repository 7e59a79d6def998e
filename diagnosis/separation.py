"""How well the responses of given captures tell one effect from another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from diagnosis.effect import SCALAR, Effect
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.simulation.sizes import grid, interpolation, node_weights

Array = NDArray[np.float64]
SEPARABLE_NATS = 3.0
"""Explanations whose expected log likelihoods differ by less cannot be told apart (odds of 20 to 1)."""


@dataclass(frozen=True)
class Separation:
    """How well one effect can be told from another.

    Attributes:
        effect, other: the true one, and the one that tries to explain it.
        share: of the true effect's response (squared, in units of the errors) that the other leaves over; 0 = the same.
        nats: log likelihood by which the true one is expected to win.
        own_nats: the same against no effect.
    """

    effect: str
    other: str
    share: float
    nats: float
    own_nats: float


@dataclass(frozen=True)
class Signature:
    """Responses of all blocks and the pixel statistics, side by side, weighted so that half the square is in nats.

    Attributes:
        blocks, pixels: what they were made from.
        weight: of a block's square.
    """

    blocks: Sequence[Block]
    pixels: PixelBlock
    weight: float

    def of(self, effect: Effect, size: Mapping[str, float]) -> Array:
        """Response to an effect of one size, [all]."""
        return np.asarray(self.rows(effect, effect.number_of(size), weights_of(effect, size))[0])

    def rows(self, effect: Effect, place: int, weights: Array) -> Array:
        """Responses for rows of node weights [sizes, nodes], [sizes, all]."""
        own = slice(place * weights.shape[1], (place + 1) * weights.shape[1])
        parts = [self.weight**0.5 * (weights @ b.stated.responses[effect.name][own]) for b in self.blocks]
        return np.concatenate([*parts, weights @ self.pixels.responses[effect.name][own]], axis=1)


def weights_of(effect: Effect, size: Mapping[str, float]) -> Array:
    """Weights of the nodes (of the size's place) for one size, [1, nodes]."""
    if effect.vector:
        return node_weights(effect, size)[None]
    return interpolation(effect, np.array([size[SCALAR]]))


def leftover(signature: Signature, target: Array, other: Effect) -> float:
    """Square that is left of a response when another effect explains it as well as it can."""
    best = float(target @ target)
    if other.vector:
        columns = signature.rows(other, 0, np.eye(2 * len(other.components)))
        return min(best, float(nnls(columns.T, target)[1] ** 2))
    for place in range(len(other.tried)):
        rows = signature.rows(other, place, interpolation(other, grid(other)))
        best = min(best, float(np.min(np.sum((target - rows) ** 2, axis=1))))
    return best


def separations(
    sizes: Mapping[str, Mapping[str, float]], blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel
) -> list[Separation]:
    """Every effect at a given size against every other; effects that only scatter are left out.

    Args:
        sizes: effect to the size at which it is to be told from the others.
        blocks, pixels: of any captures; only responses are used.
        model: for the share of independent dimensions.
    """
    names = list(blocks[0].stated.responses)
    signature = Signature(blocks, pixels, model.dimension_share)
    found = []
    for name, size in sizes.items():
        if name not in names:
            continue
        target = signature.of(get_effect(name), size)
        square = float(target @ target)
        for other in names:
            if other != name and square > 0.0:
                left = leftover(signature, target, get_effect(other))
                found.append(Separation(name, other, left / square, 0.5 * left, 0.5 * square))
    return found


def not_separable(
    name: str, size: Mapping[str, float], blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel
) -> tuple[str, ...]:
    """Effects that these captures cannot tell from one of this size."""
    found = separations({name: size}, blocks, pixels, model)
    return tuple(sorted(s.other for s in found if s.nats < SEPARABLE_NATS))


def own_nats(
    sizes: Mapping[str, Mapping[str, float]], blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel
) -> dict[str, float]:
    """Log likelihood by which each effect, at a given size, is expected to win against no effect."""
    signature = Signature(blocks, pixels, model.dimension_share)
    targets = {name: signature.of(get_effect(name), size) for name, size in sizes.items()}
    return {name: 0.5 * float(target @ target) for name, target in targets.items()}
