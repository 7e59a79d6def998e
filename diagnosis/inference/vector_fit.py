"""The size of an effect that is a vector, fitted to all blocks at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import Effect
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.inference.likelihood import LikelihoodModel, view_log_likelihood
from diagnosis.simulation.sizes import node_weights, vector_step

Array = NDArray[np.float64]


def fit_vector(
    effect: Effect,
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
    seen: Sequence[float] | None,
    size: Array,
) -> tuple[Array, Array]:
    """Size and the Hessian there, by least squares with robust weights, repeated from a first size.

    Blocks count as far as the effect shows in them at the size before.

    Args:
        effect: whose components are fitted.
        blocks, pixels, model: what was measured, and how likely it is.
        seen: of each block, log likelihood in folds in which the effect may not show; None: it shows in all.
        size: to begin at; its signs choose the responses forward or backward, [components].

    Returns:
        The size, in the components' units, [components], and the Hessian of the log posterior there, its sign turned.
    """
    step, count = vector_step(effect), len(effect.components)
    prior_sigma = 1.2 * step / np.sqrt(count)
    hessian, shown = np.eye(count), np.ones(len(blocks))
    for _ in range(12):
        own = np.where(size >= 0, np.arange(count), np.arange(count, 2 * count))
        way = (np.where(size >= 0, 1.0, -1.0) / step)[:, None]
        shared = way * pixels.responses[effect.name][own]
        hessian = np.eye(count) / prior_sigma**2 + shared @ shared.T
        right = shared @ pixels.measured
        for block, part in zip(blocks, shown, strict=True):
            view = block.stated
            columns = way * view.responses[effect.name][own]
            residual = view.measured - size @ columns
            weight = part * model.dimension_share / max(float(residual @ residual) / len(residual), 0.3)
            hessian += weight * columns @ columns.T
            right += weight * columns @ view.measured
        size = np.linalg.solve(hessian, right)
        if seen is not None:
            shown = _shown(effect, blocks, model, seen, size)
    return size, hessian


def _shown(
    effect: Effect, blocks: Sequence[Block], model: LikelihoodModel, seen: Sequence[float], size: Array
) -> Array:
    """Probability that a vector effect of some size shows in each block, [blocks]."""
    weights = node_weights(effect, dict(zip(effect.components, size.tolist(), strict=True)))
    found = []
    for block, still in zip(blocks, seen, strict=True):
        view, moved = block.stated, model.moved(block.scene)
        value = view_log_likelihood(view, view.responses[effect.name], weights[None], block.scene, model)[0]
        hidden = np.log(moved) + still if moved > 0.0 else -np.inf
        found.append(float(np.exp(np.log1p(-moved) + value - np.logaddexp(np.log1p(-moved) + value, hidden))))
    return np.array(found)
