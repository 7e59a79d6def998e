"""The size of an effect that is a vector, fitted to all blocks at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import Effect
from diagnosis.inference.block import PixelBlock
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.view_likelihood import Known
from diagnosis.simulation.sizes import node_weights, vector_step

Array = NDArray[np.float64]


def fit_vector(
    effect: Effect,
    known: Known,
    pixels: PixelBlock,
    model: LikelihoodModel,
    seen: Sequence[float] | None,
    size: Array,
) -> tuple[Array, Array]:
    """Size and the Hessian there, by least squares with robust weights, repeated from a first size.

    Blocks count as far as the effect shows in them at the size before.

    Args:
        effect: whose components are fitted.
        known: of every block with its stated parameters, and of the effect's responses.
        pixels, model: numbers that are shared, and how likely everything is.
        seen: of each block, log likelihood in folds in which the effect may not show; None: it shows in all.
        size: to begin at; its signs choose the responses forward or backward, [components].

    Returns:
        The size, in the components' units, [components], and the Hessian of the log posterior there, its sign turned.
    """
    step, count = vector_step(effect), len(effect.components)
    prior_sigma = 1.2 * step / np.sqrt(count)
    hessian, shown = np.eye(count), np.ones(len(known.count))
    for _ in range(12):
        own = np.where(size >= 0, np.arange(count), np.arange(count, 2 * count))
        way = np.where(size >= 0, 1.0, -1.0) / step
        shared = way[:, None] * pixels.responses[effect.name][own]
        products, along = np.outer(way, way) * known.products[:, own[:, None], own], way * known.along[:, own]
        residual = known.whole - 2.0 * along @ size + (products @ size) @ size
        weight = shown * model.dimension_share / np.maximum(residual / known.count, 0.3)
        hessian = np.eye(count) / prior_sigma**2 + shared @ shared.T + np.tensordot(weight, products, 1)
        size = np.linalg.solve(hessian, shared @ pixels.measured + weight @ along)
        if seen is not None:
            shown = _shown(effect, known, model, seen, size)
    return size, hessian


def _shown(effect: Effect, known: Known, model: LikelihoodModel, seen: Sequence[float], size: Array) -> Array:
    """Probability that a vector effect of some size shows in each block, [blocks]."""
    weights = node_weights(effect, dict(zip(effect.components, size.tolist(), strict=True)))
    moved = np.array([model.moved(scene) for scene in known.scenes])
    with np.errstate(divide="ignore"):
        hidden = np.log(moved) + np.array(seen)
    told = np.log1p(-moved) + known.log_likelihood(weights[None], model)[:, 0]
    return np.asarray(np.exp(told - np.logaddexp(told, hidden)))
