"""How far captures and simulations of the same thing may differ: the covariance of the features."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.fabric_task import CaptureResult


@dataclass(frozen=True)
class NoiseModel:
    """Sizes of what is not in the simulation and yet no effect; lengths [m].

    Attributes:
        floor_m: error of a cell's mean that is independent of everything.
        common_m, repeat_m: smooth difference between simulators or meshes (the same in all repeats), and between
            repeats, where the cloth is flat.
        slide_m: shift of folds along the cloth's plane (common); times the slope it is a height.
        share: relative error of heights (common).
        repeat_share: share of the two that differs between repeats.
        contact_m: height at which contact keeps the cloth off the panel, uncertainty.
        hanging_factor: all of this is so much larger in ``hanging``.
        length: correlation length of the smooth parts, in sample sizes.
        plane_m: offset and change across the panel's picture: what a stated pose and sensor are good for.
        template_share: relative error of a response.
        pixel_sigma: of each pixel statistic with a stated sensor.
    """

    floor_m: float = 0.00005
    common_m: float = 0.0002
    repeat_m: float = 0.0001
    slide_m: float = 0.0015
    share: float = 0.05
    repeat_share: float = 0.3
    contact_m: float = 0.0007
    hanging_factor: float = 3.0
    length: float = 0.12
    plane_m: float = 0.0002
    template_share: float = 0.25
    pixel_sigma: tuple[float, ...] = (0.02, 0.02, 0.1, 0.001, 0.03, 0.03)


@dataclass(frozen=True)
class Block:
    """All captures of one fabric in one scene; ``n`` measurements that were seen.

    Attributes:
        fabric, scene: whose.
        captures: ids, in the order they are stacked.
        measured: whitened measurements, [n].
        responses: effect to whitened response at each of its nodes, [nodes, n].
        factor: Cholesky factor of the covariance: ``factor @ whitened`` is in metres, [n, n].
        cell: number of the cell (cloth, ring, then the panel's three) of each measurement, [n].
        owner: which of ``captures`` it belongs to, [n].
        jacobian: change for one standard deviation of each parameter, metres, [7, n].
    """

    fabric: str
    scene: str
    captures: tuple[str, ...]
    measured: NDArray[np.float64]
    responses: dict[str, NDArray[np.float64]]
    factor: NDArray[np.float64]
    cell: NDArray[np.intp]
    owner: NDArray[np.intp]
    jacobian: NDArray[np.float64]


def make_block(captures: list[CaptureResult], sigma: tuple[float, ...], model: NoiseModel) -> Block:
    """Stack the repeats of a fabric and scene and whiten them."""
    measured = np.concatenate([c.measured.vector() for c in captures])
    seen = np.isfinite(measured)
    covariance = _covariance(captures, sigma, model)[np.ix_(seen, seen)]
    factor = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)

    def whiten(columns: NDArray[np.float64]) -> NDArray[np.float64]:
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(factor, columns[:, seen].T, lower=True).T)

    responses = {}
    for name in captures[0].responses:
        stacked = [np.concatenate([c.responses[name][n][0] for c in captures]) for n in range(_nodes(captures, name))]
        responses[name] = whiten(np.stack(stacked))
    sizes = [c.reference.count + 3 for c in captures]
    return Block(
        captures[0].fabric,
        captures[0].scene,
        tuple(c.id for c in captures),
        whiten(measured[None])[0],
        responses,
        factor,
        np.concatenate([np.arange(size) for size in sizes])[seen],
        np.repeat(np.arange(len(sizes)), sizes)[seen],
        (np.concatenate([c.jacobian for c in captures], axis=1) * np.asarray(sigma)[:, None])[:, seen],
    )


def _nodes(captures: list[CaptureResult], name: str) -> int:
    return len(captures[0].responses[name])


def _covariance(captures: list[CaptureResult], sigma: tuple[float, ...], model: NoiseModel) -> NDArray[np.float64]:
    """Covariance of the stacked shape-and-plane vectors [m²]."""
    sizes = [c.reference.count + 3 for c in captures]
    jacobian = np.concatenate([c.jacobian for c in captures], axis=1) * np.asarray(sigma)[:, None]
    total = jacobian.T @ jacobian
    starts = np.concatenate([[0], np.cumsum(sizes)])
    for a, first in enumerate(captures):
        for b, second in enumerate(captures):
            block = _smooth(first, second, model, same=a == b)
            total[starts[a] : starts[a] + len(block), starts[b] : starts[b] + block.shape[1]] += block
        end = starts[a + 1]
        pixel = np.exp(2 * np.nan_to_num(first.measured.pixels[0], nan=-6.9))
        variance = model.floor_m**2 + pixel / np.maximum(first.measured.weight, 1)
        diagonal = np.concatenate([variance, np.full(3, model.plane_m**2)])
        total[starts[a] : end, starts[a] : end][np.diag_indices(sizes[a])] += diagonal
    return np.asarray(total)


def _smooth(first: CaptureResult, second: CaptureResult, model: NoiseModel, *, same: bool) -> NDArray[np.float64]:
    """Smooth model error between the cells of two captures."""
    a, b = first.reference, second.reference
    distance = np.linalg.norm(a.centre[:, None] - b.centre[None], axis=2)
    kernel = np.exp(-0.5 * (distance / model.length) ** 2)
    scale = model.hanging_factor if first.scene == "hanging" else 1.0
    repeat = (model.repeat_share**2 + 1.0) if same else 1.0
    flat = model.common_m**2 + (model.repeat_m**2 if same else 0.0)
    slide = model.slide_m**2 * np.outer(a.slope, b.slope) * repeat
    height = model.share**2 * np.outer(np.abs(a.height), np.abs(b.height)) * repeat
    cloth_a, cloth_b = a.slope > 0, b.slope > 0
    contact = model.contact_m**2 * np.outer(cloth_a, cloth_b)
    return np.asarray(scale**2 * kernel * (flat + slide + height) + contact)


@dataclass(frozen=True)
class PixelBlock:
    """Pixel statistics of all captures, each in units of its own uncertainty.

    Attributes:
        measured: deviation from what the stated sensor gives, [captures * statistics], NaN-free.
        responses: effect to its response at each node, [nodes, captures * statistics].
    """

    measured: NDArray[np.float64]
    responses: dict[str, NDArray[np.float64]]


def make_pixel_block(captures: list[CaptureResult], model: NoiseModel) -> PixelBlock:
    """Average each statistic over the captures that have it; sensors are the same in all of them."""
    deviation = np.stack([c.measured.pixels - c.sensed for c in captures if c.sensor_known] or [np.full(6, np.nan)])
    seen = np.isfinite(deviation)
    count = seen.sum(axis=0)
    usable = count > 0
    scale = np.asarray(model.pixel_sigma) * np.sqrt(1.0 + 1.0 / np.maximum(count, 1))

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        total = np.where(seen, values, 0.0).sum(axis=0) / np.maximum(count, 1)
        return np.asarray((total / scale)[usable])

    responses = {}
    known = [c for c in captures if c.sensor_known]
    for name in captures[0].responses:
        nodes = range(_nodes(captures, name))
        rows = [mean(np.stack([c.responses[name][n][1] for c in known] or [np.zeros(6)])) for n in nodes]
        responses[name] = np.stack(rows)
    return PixelBlock(mean(deviation), responses)
