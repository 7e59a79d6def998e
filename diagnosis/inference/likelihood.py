"""The likelihood's model, and how blocks and shared numbers come together in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from diagnosis.inference.block import Block, PixelBlock

Array = NDArray[np.float64]
FACTORS = np.geomspace(2.0, 300.0, 33)
"""By how much pixel statistics may be off when something unknown is there."""
WILD_SHARES = (0.1, 0.3)
"""Of the pixel statistics, when something unknown is there: how many are off is not known either."""
SCALES = np.geomspace(0.3, 8.0, 25)
"""By how much errors of an ordinary block may be smaller or larger than modelled."""
ALONE_NATS = 2.0
"""An explanation may gain so much more by one fabric than by any other."""


@dataclass(frozen=True)
class LikelihoodModel:
    """How the likelihood is formed.

    Attributes:
        spread_stretch, spread_hanging: how uncertain the size of a block's (one fabric in one scene) errors is,
            standard deviation of its logarithm.
        least_scale: least size of a block's errors, of what is modelled.
        dimension_share: share of a block's dimensions that counts as independent.
        degrees: Student's degrees of freedom of the tests of gap and regions.
        pixel_degrees: of each pixel statistic.
        template_share, form_share: relative error of a simulated response in its length, and in its form.
        patience_stretch, patience_hanging: log likelihood that a block may lose before it is heard less.
        wide_fabric: probability that a fabric's stated parameters are wrong.
        moved_stretch, moved_hanging: probability that the cloth rests in the folds it is seen in with an effect on as
            without, although the continued simulation left them: its state was sought without the effect.
    """

    spread_stretch: float = 0.35
    spread_hanging: float = 0.8
    least_scale: float = float(SCALES[0])
    dimension_share: float = 0.25
    degrees: float = 20.0
    pixel_degrees: float = 8.0
    template_share: float = 0.08
    form_share: float = 0.15
    patience_stretch: float = 2.5
    patience_hanging: float = 0.8
    wide_fabric: float = 0.05
    moved_stretch: float = 0.0
    moved_hanging: float = 0.3

    def log_density(self, square: Array, dimension: Array | float, scene: str) -> Array:
        """Log density of ``dimension`` errors of one unknown scale at squared length ``square`` (up to 2 pi's)."""
        dimension = np.asarray(dimension)
        spread = self.spread_hanging if scene == "hanging" else self.spread_stretch
        scales, weight = _scales(spread, self.least_scale)
        values = -0.5 * np.asarray(square)[..., None] / scales**2 - dimension[..., None] * np.log(scales) + weight
        most = values.max(axis=-1)  # scipy's logsumexp takes three times as long over rows this short
        total = most + np.log(np.exp(values - most[..., None]).sum(axis=-1))
        return np.asarray(total - 0.5 * dimension * np.log(2 * np.pi))

    def patience(self, scene: str) -> float:
        """Of a block of this scene."""
        return self.patience_hanging if scene == "hanging" else self.patience_stretch

    def counted(self, nats: Array | float, scene: str) -> Array:
        """Difference of a block's log likelihoods: in full while small and like its logarithm when large."""
        patience = self.patience(scene)
        return np.asarray(patience * np.sign(nats) * np.log1p(np.abs(nats) / patience))

    @property
    def rough(self) -> bool:
        """Responses are not yet trusted in any scene."""
        return self.moved_stretch > 0.0

    def moved(self, scene: str) -> float:
        """Of a block of this scene."""
        return self.moved_hanging if scene == "hanging" else self.moved_stretch


@cache
def _scales(spread: float, least: float) -> tuple[Array, Array]:
    """Those of :data:`SCALES` that are not below the least one, and the log of their weights, [scales]."""
    scales = SCALES[least <= SCALES]
    weight = -0.5 * (np.log(scales) / spread) ** 2
    return scales, np.asarray(weight - logsumexp(weight))


def log_student(square: Array | float, dimension: float, degrees: float) -> Array:
    """Log density of a standard multivariate Student t at squared length ``square``."""
    return np.asarray(
        gammaln(0.5 * (degrees + dimension))
        - gammaln(0.5 * degrees)
        - 0.5 * dimension * np.log(degrees * np.pi)
        - 0.5 * (degrees + dimension) * np.log1p(np.asarray(square) / degrees)
    )


def over_views(value: Array, model: LikelihoodModel) -> Array:
    """Of a block whose fabric may have wrong parameters: [views, sizes] to [sizes]."""
    stated, wide = value
    return np.asarray(np.logaddexp(stated + np.log1p(-model.wide_fabric), wide + np.log(model.wide_fabric)))


def combine(
    blocks: Sequence[Block], values: Sequence[Array], best: Sequence[float], model: LikelihoodModel
) -> tuple[Array, dict[str, Array]]:
    """Blocks to everything, so that none outvotes the others.

    What a block loses or gains against a reference counts in full while it is small and like its logarithm when it is
    large: one block or fabric that is odd for a reason of its own decides nothing.

    Args:
        blocks: all blocks.
        values: log likelihood of each block, [sizes].
        best: of each block, under the explanation that others are held against.
        model: see there.

    Returns:
        Sum over blocks, [sizes], and by fabric.
    """
    fabrics: dict[str, Array] = {}
    for block, value, top in zip(blocks, values, best, strict=True):
        loss = model.counted(top - value, block.scene)
        fabrics[block.fabric] = fabrics.get(block.fabric, np.zeros_like(loss)) - loss
    return np.asarray(sum(fabrics.values())), fabrics


def pixel_log_likelihood(
    pixels: PixelBlock, response: Array, model: LikelihoodModel, vague: Array | float = 0.0
) -> Array:
    """Of the pixel statistics for many sizes, [sizes]; each an independent t.

    Args:
        pixels: measured.
        response: to what is tried, [sizes, m]; uncertain by a share, as is what was taken away before.
        model: see there.
        vague: standard deviation of the response beyond that, [m].
    """
    spread = _pixel_spread(pixels, response, model, vague)
    residual = (pixels.measured - response) / spread
    values = log_student(residual**2, 1.0, model.pixel_degrees) - np.log(spread)
    return np.asarray(values.sum(axis=1))


def pixel_unknown(pixels: PixelBlock, model: LikelihoodModel) -> float:
    """Of pixel statistics some of which are off by any factor, each for itself."""
    calm = pixel_log_likelihood(pixels, np.zeros((1, len(pixels.measured))), model)
    return float(calm[0]) + some_off(pixels, model)


def some_off(pixels: PixelBlock, model: LikelihoodModel, among: NDArray[np.bool_] | None = None) -> float:
    """Log likelihood of pixel statistics at least one of which is off by any factor, over that of none; 0 without any.

    Args:
        pixels: measured.
        model: see there.
        among: those that may be off, [m]; all by default.
    """
    spread = _pixel_spread(pixels, np.zeros(len(pixels.measured)), model)
    square = (pixels.measured / spread)[slice(None) if among is None else among, None] ** 2
    if not len(square):
        return 0.0
    wild = logsumexp(log_student(square / FACTORS**2, 1.0, model.pixel_degrees) - np.log(FACTORS), axis=1)
    off = wild - np.log(len(FACTORS)) - log_student(square[:, 0], 1.0, model.pixel_degrees)
    share, all_calm = np.array(WILD_SHARES), (1.0 - np.array(WILD_SHARES)) ** len(off)
    either = np.logaddexp(np.log(share)[:, None] + off, np.log1p(-share)[:, None]).sum(axis=1)
    return float(logsumexp(either + np.log1p(-all_calm * np.exp(-either)) - np.log1p(-all_calm)) - np.log(len(share)))


def _pixel_spread(pixels: PixelBlock, response: Array, model: LikelihoodModel, vague: Array | float = 0.0) -> Array:
    share = response**2 + sum(row**2 for row in pixels.taken)
    return np.asarray(np.sqrt(1.0 + model.template_share**2 * share + vague**2 + pixels.vague))
