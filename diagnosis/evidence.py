"""How well each effect explains the captures: evidence by heavy-tailed likelihoods, magnitudes marginalised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from diagnosis.effect import SCALAR, Effect
from diagnosis.noise import Block, PixelBlock
from diagnosis.sizes import grid, interpolation, log_prior


@dataclass(frozen=True)
class EvidenceModel:
    """How the likelihood is formed.

    Attributes:
        degrees: Student's degrees of freedom of a block (one fabric in one scene).
        dimension_share: share of a block's dimensions that counts as independent.
        pixel_degrees: of the pixel statistics.
        template_share: relative error of a simulated response.
        unknown_penalty: log odds against ``unknown`` before anything is seen.
        none_prior: prior probability of no effect.
    """

    degrees: float = 6.0
    dimension_share: float = 0.15
    pixel_degrees: float = 4.0
    template_share: float = 0.2
    unknown_penalty: float = 6.0
    none_prior: float = 0.3


@dataclass(frozen=True)
class EffectEvidence:
    """Evidence for one explanation.

    Attributes:
        name: effect, ``none`` or ``unknown``.
        log_evidence: of all captures together.
        by_fabric: the same at the best size, fabric and scene by fabric and scene.
        size: most probable size by component; empty for ``none`` and ``unknown``.
        interval_90: by component.
    """

    name: str
    log_evidence: float
    by_block: dict[tuple[str, str], float]
    size: dict[str, float]
    interval_90: dict[str, tuple[float, float]]


def log_student(square: NDArray[np.float64] | float, dimension: float, degrees: float) -> NDArray[np.float64]:
    """Log density of a standard multivariate Student t at squared length ``square``, up to the dimension's share."""
    return np.asarray(
        gammaln(0.5 * (degrees + dimension))
        - gammaln(0.5 * degrees)
        - 0.5 * dimension * np.log(degrees * np.pi)
        - 0.5 * (degrees + dimension) * np.log1p(np.asarray(square) / degrees)
    )


def block_log_likelihood(
    residual: NDArray[np.float64], response: NDArray[np.float64], model: EvidenceModel
) -> NDArray[np.float64]:
    """Log likelihood of one block for many sizes at once.

    The response has a relative error: covariance I + (share)² t tᵀ, by Sherman and Morrison.

    Args:
        residual: measured minus response, whitened, [sizes, n].
        response: whitened, [sizes, n].
        model: see there.
    """
    dimension = residual.shape[1] * model.dimension_share
    square = np.einsum("gn,gn->g", residual, residual)
    norm = np.einsum("gn,gn->g", response, response)
    cross = np.einsum("gn,gn->g", residual, response)
    weight = model.template_share**2
    square = (square - weight * cross**2 / (1 + weight * norm)) * model.dimension_share
    log_det = np.log1p(weight * norm)
    return np.asarray(log_student(square, dimension, model.degrees) - 0.5 * log_det)


def explain_scalar(effect: Effect, blocks: list[Block], pixels: PixelBlock, model: EvidenceModel) -> EffectEvidence:
    """Evidence of an effect whose size is one number, on a grid of sizes common to all fabrics."""
    sizes = grid(effect)
    weights = interpolation(effect, sizes)
    by_block = {}
    total = np.zeros(len(sizes))
    for block in blocks:
        response = weights @ block.responses[effect.name]
        value = block_log_likelihood(block.measured - response, response, model)
        by_block[block.fabric, block.scene] = value
        total += value
    total += _pixel_log_likelihood(pixels, weights @ pixels.responses[effect.name], model)
    posterior = total + log_prior(effect, sizes)
    evidence = float(logsumexp(posterior))
    mass = np.exp(posterior - evidence)
    best = int(np.argmax(posterior))
    order = np.argsort(sizes)
    cumulative = np.cumsum(mass[order])
    low, high = (float(np.interp(q, cumulative, sizes[order])) for q in (0.05, 0.95))
    return EffectEvidence(
        effect.name,
        evidence,
        {key: float(value[best]) for key, value in by_block.items()},
        {SCALAR: float(sizes[best])},
        {SCALAR: (low, high)},
    )


def explain_vector(effect: Effect, blocks: list[Block], pixels: PixelBlock, model: EvidenceModel) -> EffectEvidence:
    """Evidence of an effect with a linear response to a vector: Gaussian prior, Laplace's approximation.

    The blocks' Student weights are found by repeated reweighting (EM for the t distribution).
    """
    component = next(iter(effect.components.values()))
    step = float(np.sqrt(component.low * component.high))
    prior_sigma = step / np.sqrt(len(effect.components)) * 1.2
    count = len(effect.components)
    size = np.zeros(count)
    hessian = np.eye(count)
    for _ in range(12):
        hessian = np.eye(count) / prior_sigma**2
        right = np.zeros(count)
        for block in blocks:
            columns = block.responses[effect.name] / step
            residual = block.measured - size @ columns
            dimension = len(residual) * model.dimension_share
            weight = (model.degrees + dimension) / (model.degrees + model.dimension_share * float(residual @ residual))
            weight *= model.dimension_share
            hessian += weight * columns @ columns.T
            right += weight * columns @ block.measured
        size = np.linalg.solve(hessian, right)
    total = -0.5 * float(size @ size) / prior_sigma**2 - count * np.log(prior_sigma)
    total -= 0.5 * float(np.linalg.slogdet(hessian)[1])
    by_block = {}
    for block in blocks:
        response = (size @ block.responses[effect.name] / step)[None]
        value = float(block_log_likelihood(block.measured - response, response, model)[0])
        by_block[block.fabric, block.scene] = value
        total += value
    total += float(_pixel_log_likelihood(pixels, np.zeros((1, len(pixels.measured))), model)[0])
    sigma = np.sqrt(np.diag(np.linalg.inv(hessian)))
    names = list(effect.components)
    return EffectEvidence(
        effect.name,
        total,
        by_block,
        {n: float(s) for n, s in zip(names, size, strict=True)},
        {n: (float(s - 1.645 * d), float(s + 1.645 * d)) for n, s, d in zip(names, size, sigma, strict=True)},
    )


def explain_nothing(blocks: list[Block], pixels: PixelBlock, model: EvidenceModel) -> EffectEvidence:
    """Evidence of no effect."""
    by_block = {}
    for block in blocks:
        still = np.zeros((1, len(block.measured)))
        by_block[block.fabric, block.scene] = float(block_log_likelihood(block.measured[None], still, model)[0])
    pixel = float(_pixel_log_likelihood(pixels, np.zeros((1, len(pixels.measured))), model)[0])
    return EffectEvidence("none", sum(by_block.values()) + pixel, by_block, {}, {})


def explain_unknown(blocks: list[Block], pixels: PixelBlock, model: EvidenceModel) -> EffectEvidence:
    """Evidence of something that no effect describes: each block's errors larger by an unknown factor, log-uniform."""
    factors = np.geomspace(1.0, 300.0, 25)
    by_block = {}
    for block in blocks:
        dimension = len(block.measured) * model.dimension_share
        square = float(block.measured @ block.measured) * model.dimension_share
        values = log_student(square / factors**2, dimension, model.degrees) - dimension * np.log(factors)
        by_block[block.fabric, block.scene] = float(logsumexp(values) - np.log(len(factors)))
    dimension = len(pixels.measured)
    square = float(pixels.measured @ pixels.measured)
    values = log_student(square / factors**2, dimension, model.pixel_degrees) - dimension * np.log(factors)
    pixel = float(logsumexp(values) - np.log(len(factors)))
    return EffectEvidence("unknown", sum(by_block.values()) + pixel - model.unknown_penalty, by_block, {}, {})


def _pixel_log_likelihood(
    pixels: PixelBlock, response: NDArray[np.float64], model: EvidenceModel
) -> NDArray[np.float64]:
    """Log likelihood of the pixel statistics for many sizes; responses are uncertain by a share; independent t each."""
    spread = np.sqrt(1.0 + (model.template_share * response) ** 2)
    residual = (pixels.measured - response) / spread
    values = log_student(residual**2, 1.0, model.pixel_degrees) - np.log(spread)
    return np.asarray(values.sum(axis=1))
