"""How probable the measurements of a fabric are once an explanation's response is taken away."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from diagnosis.block import Block, PixelBlock

Array = NDArray[np.float64]
FACTORS = np.geomspace(1.0, 100.0, 33)
"""By how much errors may be larger than modelled in a spoiled block."""


@dataclass(frozen=True)
class LikelihoodModel:
    """How the likelihood is formed.

    Attributes:
        degrees: Student's degrees of freedom of a block (one fabric in one scene).
        dimension_share: share of a block's dimensions that counts as independent.
        pixel_degrees: of each pixel statistic.
        template_share: relative error of a simulated response.
        spoiled: probability that a block is spoiled (its folds were not found), by scene.
        wrong_fabric: probability that a fabric's stated parameters are wrong.
    """

    degrees: float = 20.0
    dimension_share: float = 0.15
    pixel_degrees: float = 8.0
    template_share: float = 0.2
    spoiled_stretch: float = 0.05
    spoiled_hanging: float = 0.3
    wrong_fabric: float = 0.03

    def spoiled(self, scene: str) -> float:
        """Probability that a block of this scene is spoiled."""
        return self.spoiled_hanging if scene == "hanging" else self.spoiled_stretch


def log_student(square: Array | float, dimension: float, degrees: float) -> Array:
    """Log density of a standard multivariate Student t at squared length ``square``."""
    return np.asarray(
        gammaln(0.5 * (degrees + dimension))
        - gammaln(0.5 * degrees)
        - 0.5 * dimension * np.log(degrees * np.pi)
        - 0.5 * (degrees + dimension) * np.log1p(np.asarray(square) / degrees)
    )


def spoiled_log_likelihood(block: Block, model: LikelihoodModel) -> float:
    """Of a block whose errors are larger than modelled by an unknown factor, log-uniform, whatever the explanation."""
    view = block.stated
    dimension = len(view.measured) * model.dimension_share
    square = float(view.measured @ view.measured) * model.dimension_share
    values = -0.5 * square / FACTORS**2 - dimension * (np.log(FACTORS) + 0.5 * np.log(2 * np.pi))
    return float(logsumexp(values) - np.log(len(FACTORS))) - model.dimension_share * view.log_det


def view_log_likelihood(residual: Array, response: Array, log_det: float, model: LikelihoodModel) -> Array:
    """Of one block under one covariance for many sizes at once.

    The response has a relative error: covariance I + share² t tᵀ, by Sherman and Morrison.

    Args:
        residual: measured minus response, whitened, [sizes, n].
        response: whitened, [sizes, n].
        log_det: half the log determinant of the covariance.
        model: see there.

    Returns:
        [sizes].
    """
    dimension = residual.shape[1] * model.dimension_share
    square = np.einsum("gn,gn->g", residual, residual)
    norm = np.einsum("gn,gn->g", response, response)
    cross = np.einsum("gn,gn->g", residual, response)
    weight = model.template_share**2
    square = (square - weight * cross**2 / (1 + weight * norm)) * model.dimension_share
    spread = 0.5 * np.log1p(weight * norm) + model.dimension_share * log_det
    return np.asarray(log_student(square, dimension, model.degrees) - spread)


def combine(blocks: Sequence[Block], values: Sequence[Array], model: LikelihoodModel) -> tuple[Array, dict[str, Array]]:
    """Blocks to fabrics to everything: a block may be spoiled, a fabric's parameters may be wrong.

    Args:
        blocks: all blocks.
        values: log likelihood of each block under each of its views, [views, sizes].
        model: see there.

    Returns:
        Sum over fabrics, [sizes], and by fabric.
    """
    by_fabric: dict[str, Array] = {}
    for block, value in zip(blocks, values, strict=True):
        share = model.spoiled(block.scene)
        bad = spoiled_log_likelihood(block, model) + np.log(share)
        mixed = np.logaddexp(value + np.log1p(-share), bad)
        by_fabric[block.fabric] = by_fabric.get(block.fabric, np.zeros_like(mixed)) + mixed
    weights = np.log([1 - model.wrong_fabric, model.wrong_fabric])[:, None]
    fabrics = {name: np.asarray(logsumexp(value + weights, axis=0)) for name, value in by_fabric.items()}
    return np.asarray(sum(fabrics.values())), fabrics


def pixel_log_likelihood(pixels: PixelBlock, response: Array, model: LikelihoodModel) -> Array:
    """Of the pixel statistics for many sizes, [sizes]; responses are uncertain by a share; each an independent t."""
    spread = np.sqrt(1.0 + (model.template_share * response) ** 2)
    residual = (pixels.measured - response) / spread
    values = log_student(residual**2, 1.0, model.pixel_degrees) - np.log(spread)
    return np.asarray(values.sum(axis=1))


def pixel_unknown(pixels: PixelBlock, model: LikelihoodModel) -> float:
    """Of pixel statistics that are off by any factor, each for itself."""
    if not len(pixels.measured):
        return 0.0
    square = pixels.measured[:, None] ** 2 / FACTORS**2
    values = log_student(square, 1.0, model.pixel_degrees) - np.log(FACTORS)
    return float((logsumexp(values, axis=1) - np.log(len(FACTORS))).sum())
