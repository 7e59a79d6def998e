"""How well each effect explains the captures, its size marginalised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.block import Block, PixelBlock, View
from diagnosis.effect import SCALAR, Effect
from diagnosis.likelihood import (
    LikelihoodModel,
    combine,
    log_student,
    pixel_log_likelihood,
    pixel_unknown,
    spoiled_log_likelihood,
    view_log_likelihood,
)
from diagnosis.sizes import grid, interpolation, log_prior, node_values, vector_step

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """One explanation weighed.

    Attributes:
        name: effect, ``none`` or ``unknown``.
        log_evidence: of all captures together, size marginalised.
        best: log likelihood at the best size.
        by_fabric: the same fabric by fabric.
        size: most probable size, by component; empty for ``none`` and ``unknown``.
        interval_90: of the components that have a prior.
    """

    name: str
    log_evidence: float
    best: float
    by_fabric: dict[str, float]
    size: dict[str, float]
    interval_90: dict[str, tuple[float, float]]


def explain(effect: Effect, blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Evidence:
    """Weigh one effect, its size common to all fabrics."""
    if effect.vector:
        return _explain_vector(effect, blocks, pixels, model)
    if effect.random_repeats:
        return _explain_scatter(effect, blocks, pixels, model)
    return _explain_scalar(effect, blocks, pixels, model)


def explain_nothing(blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Evidence:
    """Weigh no effect."""
    values = []
    for block in blocks:
        rows = [_at_rest(view, model) for view in block.views]
        values.append(np.stack(rows))
    total, fabrics = combine(blocks, values, model)
    score = float(total[0]) + float(pixel_log_likelihood(pixels, np.zeros((1, len(pixels.measured))), model)[0])
    return Evidence("none", score, score, {k: float(v[0]) for k, v in fabrics.items()}, {}, {})


def explain_unknown(blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Evidence:
    """Weigh something that no effect describes: in the shape, in the pixels or in both."""
    spoiled: dict[str, float] = {}
    for block in blocks:
        spoiled[block.fabric] = spoiled.get(block.fabric, 0.0) + spoiled_log_likelihood(block, model)
    shape = sum(spoiled.values())
    nothing = explain_nothing(blocks, pixels, model)
    calm = float(pixel_log_likelihood(pixels, np.zeros((1, len(pixels.measured))), model)[0])
    wild = pixel_unknown(pixels, model)
    cases = [shape + calm, shape + wild, nothing.best - calm + wild]
    score = float(logsumexp(cases) - np.log(len(cases)))
    return Evidence("unknown", score, score, spoiled, {}, {})


def _at_rest(view: View, model: LikelihoodModel) -> Array:
    still = np.zeros((1, len(view.measured)))
    return view_log_likelihood(view.measured[None], still, view.log_det, model)


def _explain_scalar(effect: Effect, blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Evidence:
    """On a grid of sizes and over the effect's places."""
    sizes = grid(effect)
    weights = interpolation(effect, sizes)
    count = weights.shape[1]
    likelihood = np.empty((len(effect.places), len(sizes)))
    parts: list[dict[str, Array]] = []
    for number in range(len(effect.places)):
        own = slice(number * count, (number + 1) * count)
        values = []
        for block in blocks:
            rows = []
            for view in block.views:
                response = weights @ view.responses[effect.name][own]
                rows.append(view_log_likelihood(view.measured - response, response, view.log_det, model))
            values.append(np.stack(rows))
        total, fabrics = combine(blocks, values, model)
        parts.append(fabrics)
        likelihood[number] = total + pixel_log_likelihood(pixels, weights @ pixels.responses[effect.name][own], model)
    posterior = likelihood + log_prior(effect, sizes) - np.log(len(effect.places))
    evidence = float(logsumexp(posterior))
    place, best = np.unravel_index(int(np.argmax(posterior)), posterior.shape)
    return Evidence(
        effect.name,
        evidence,
        float(likelihood[place, best]),
        {key: float(value[best]) for key, value in parts[place].items()},
        {SCALAR: float(sizes[best])} | dict(effect.places[place]),
        {SCALAR: _interval(sizes, np.exp(posterior - evidence).sum(axis=0))},
    )


def _explain_scatter(effect: Effect, blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Evidence:
    """An effect that is another in every repeat widens the blocks' covariance.

    The responses simulated for some random draws give the spread; captures are taken as independent of one another.
    """
    sizes = grid(effect)
    step = np.abs(sizes) / node_values(effect)[0]
    values = []
    for block in blocks:
        rows = []
        for view in block.views:
            draws = view.scatter[effect.name] / np.sqrt(len(effect.places))
            _, spread, directions = np.linalg.svd(draws, full_matrices=False)
            along = directions @ view.measured
            dimension = len(view.measured) * model.dimension_share
            rest = float(view.measured @ view.measured) - float(along @ along)
            variance = 1.0 + np.outer(step**2, spread**2)
            square = (rest + (along**2 / variance).sum(axis=1)) * model.dimension_share
            row = log_student(square, dimension, model.degrees) - model.dimension_share * view.log_det
            rows.append(row - 0.5 * model.dimension_share * np.log(variance).sum(axis=1))
        values.append(np.stack(rows))
    total, fabrics = combine(blocks, values, model)
    likelihood = total + pixel_log_likelihood(pixels, np.zeros((1, len(pixels.measured))), model)[0]
    posterior = likelihood + log_prior(effect, sizes)
    evidence = float(logsumexp(posterior))
    best = int(np.argmax(posterior))
    return Evidence(
        effect.name,
        evidence,
        float(likelihood[best]),
        {key: float(value[best]) for key, value in fabrics.items()},
        {SCALAR: float(sizes[best])} | dict(effect.places[0]),
        {SCALAR: _interval(sizes, np.exp(posterior - evidence))},
    )


def _explain_vector(effect: Effect, blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Evidence:
    """Linear response, Gaussian prior, Laplace's approximation; Student weights by repeated reweighting."""
    step = vector_step(effect)
    count = len(effect.components)
    prior_sigma = 1.2 * step / np.sqrt(count)
    size, hessian = np.zeros(count), np.eye(count)
    for _ in range(12):
        hessian = np.eye(count) / prior_sigma**2
        right = np.zeros(count)
        for block in blocks:
            view = block.stated
            columns = view.responses[effect.name] / step
            residual = view.measured - size @ columns
            dimension = len(residual) * model.dimension_share
            square = model.dimension_share * float(residual @ residual)
            weight = model.dimension_share * (model.degrees + dimension) / (model.degrees + square)
            hessian += weight * columns @ columns.T
            right += weight * columns @ view.measured
        size = np.linalg.solve(hessian, right)
    values = []
    for block in blocks:
        rows = []
        for view in block.views:
            response = (size @ view.responses[effect.name] / step)[None]
            rows.append(view_log_likelihood(view.measured - response, response, view.log_det, model))
        values.append(np.stack(rows))
    total, fabrics = combine(blocks, values, model)
    best = float(total[0]) + float(pixel_log_likelihood(pixels, np.zeros((1, len(pixels.measured))), model)[0])
    occam = -0.5 * float(size @ size) / prior_sigma**2 - count * np.log(prior_sigma)
    occam -= 0.5 * float(np.linalg.slogdet(hessian)[1])
    sigma = np.sqrt(np.diag(np.linalg.inv(hessian)))
    names = list(effect.components)
    return Evidence(
        effect.name,
        best + occam,
        best,
        {key: float(value[0]) for key, value in fabrics.items()},
        {n: float(s) for n, s in zip(names, size, strict=True)},
        {n: (float(s - 1.645 * d), float(s + 1.645 * d)) for n, s, d in zip(names, size, sigma, strict=True)},
    )


def _interval(sizes: Array, mass: Array) -> tuple[float, float]:
    """5 and 95 % points of a distribution on a grid."""
    order = np.argsort(sizes)
    cumulative = np.cumsum(mass[order])
    low, high = (float(np.interp(q, cumulative, sizes[order])) for q in (0.05, 0.95))
    return low, high
