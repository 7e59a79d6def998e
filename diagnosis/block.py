"""Measurements and responses in units in which their errors are independent and of size one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.effects import get_effect
from diagnosis.fabric_task import CaptureResult
from diagnosis.noise import NoiseModel, feature_covariance, stacked_jacobian
from diagnosis.pixel_statistics import PIXEL_NAMES

Array = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """A block under one covariance.

    Attributes:
        measured: whitened measurements, [n].
        responses: effect to whitened response at each of its nodes, [nodes, n].
        scatter: effect that differs between repeats to whitened responses, each draw on each capture alone, [rows, n].
        factor: Cholesky factor of the covariance: ``factor @ whitened`` is in metres, [n, n].
        log_det: half the log determinant of the covariance.
    """

    measured: Array
    responses: dict[str, Array]
    scatter: dict[str, Array]
    factor: Array
    log_det: float


@dataclass(frozen=True)
class Block:
    """All captures of one fabric in one scene; ``n`` measurements that were seen.

    Attributes:
        fabric, scene: whose.
        captures: ids, in the order they are stacked.
        stated: with the stated uncertainty of the parameters.
        wide: as if the parameters of this fabric were wrong.
        cell: number of the cell (cloth, ring, then the panel's three) of each measurement, [n].
        owner: which of ``captures`` it belongs to, [n].
        jacobian: change for one stated standard deviation of each parameter [m], [7, n].
    """

    fabric: str
    scene: str
    captures: tuple[str, ...]
    stated: View
    wide: View
    cell: NDArray[np.intp]
    owner: NDArray[np.intp]
    jacobian: Array

    @property
    def views(self) -> tuple[View, View]:
        """Stated, then wide."""
        return (self.stated, self.wide)

    def metres(self, whitened: Array) -> Array:
        """From the stated view's units to metres, [n]."""
        return np.asarray(self.stated.factor @ whitened)


def make_block(captures: Sequence[CaptureResult], sigma: Sequence[float], model: NoiseModel) -> Block:
    """Stack the repeats of a fabric and scene and whiten them.

    Args:
        captures: of one fabric in one scene.
        sigma: stated relative uncertainty of the seven parameters.
        model: all other errors.
    """
    measured = np.concatenate([c.measured.vector() for c in captures])
    seen = np.isfinite(measured)
    stacked = {name: _stacked(captures, name)[:, seen] for name in captures[0].responses.effects}
    sizes = [c.reference.count + 3 for c in captures]
    owner = np.repeat(np.arange(len(sizes)), sizes)[seen]
    wide = [max(s, model.wide_sigma) for s in sigma[:6]] + [sigma[6]]
    views = [
        _view(measured[seen], stacked, owner, feature_covariance(captures, s, model)[np.ix_(seen, seen)])
        for s in (sigma, wide)
    ]
    return Block(
        captures[0].fabric,
        captures[0].scene,
        tuple(c.id for c in captures),
        views[0],
        views[1],
        np.concatenate([np.arange(size) for size in sizes])[seen],
        owner,
        stacked_jacobian(captures, sigma)[:, seen],
    )


def _stacked(captures: Sequence[CaptureResult], name: str) -> Array:
    return np.concatenate([c.responses.effects[name][0] for c in captures], axis=1)


def _view(measured: Array, stacked: dict[str, Array], owner: NDArray[np.intp], covariance: Array) -> View:
    from scipy.linalg import solve_triangular

    factor = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)

    def whiten(rows: Array) -> Array:
        return np.asarray(solve_triangular(factor, rows.T, lower=True).T)

    responses, scatter = {}, {}
    for name, rows in stacked.items():
        if get_effect(name).random_repeats:
            scatter[name] = whiten(np.concatenate([rows * (owner == k) for k in range(int(owner.max()) + 1)]))
        else:
            responses[name] = whiten(rows)
    log_det = float(np.log(np.diag(factor)).sum())
    return View(whiten(measured[None])[0], responses, scatter, factor, log_det)


@dataclass(frozen=True)
class PixelBlock:
    """Pixel statistics of all captures, each in units of its own uncertainty.

    Attributes:
        measured: deviation from what the stated sensor gives, [m], NaN-free.
        responses: effect to its response at each node, [nodes, m].
    """

    measured: Array
    responses: dict[str, Array]


def make_pixel_block(captures: Sequence[CaptureResult], model: NoiseModel) -> PixelBlock:
    """Average each statistic over the captures that have it and whose sensor is stated; the sensor is one for all."""
    known = [c for c in captures if c.sensor_known]
    if not known:
        empty = {name: np.zeros((len(rows[0]), 0)) for name, rows in captures[0].responses.effects.items()}
        return PixelBlock(np.zeros(0), empty)
    deviation = np.stack([c.measured.pixels - c.responses.sensed for c in known])
    seen = np.isfinite(deviation)
    count = seen.sum(axis=0)
    scale = np.asarray(model.pixel_sigma) * np.sqrt(1.0 + 1.0 / np.maximum(count, 1))
    usable = count > 0
    assert len(scale) == len(PIXEL_NAMES)

    def mean(values: Array) -> Array:
        total = np.where(seen, values, 0.0).sum(axis=0) / np.maximum(count, 1)
        return np.asarray((total / scale)[usable])

    responses = {
        name: np.stack([mean(np.stack([c.responses.effects[name][1][n] for c in known])) for n in range(len(rows[0]))])
        for name, rows in captures[0].responses.effects.items()
    }
    return PixelBlock(mean(deviation), responses)
