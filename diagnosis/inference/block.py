"""Measurements and responses in units in which their errors are independent and of size one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from diagnosis.effects import get_effect
from diagnosis.inference.noise import NoiseModel, feature_covariance, sensor_variance, stacked_jacobian
from diagnosis.measurement.pixel_statistics import PIXEL_NAMES
from diagnosis.measurement.reference import PLANE_NAMES
from diagnosis.tasks.fabric_task import CaptureResult

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
        beside: (effect, other) to whitened response of the effect at each of its nodes where the other is there, too,
            [nodes, n].
        taken: whitened responses that were taken away from the measurements, [n] each; they are uncertain, too.
    """

    measured: Array
    responses: dict[str, Array]
    scatter: dict[str, Array]
    factor: Array
    log_det: float
    beside: Mapping[tuple[str, str], Array] = field(default_factory=dict)
    taken: tuple[Array, ...] = ()


@dataclass(frozen=True)
class Block:
    """All captures of one fabric in one scene; ``n`` measurements that were seen.

    Attributes:
        fabric, scene: whose.
        captures: ids, in the order they are stacked.
        stated: with the stated uncertainty of the parameters.
        wide: as if the parameters of this fabric were wrong.
        cell: number of the cell (cloth, then ring) of each measurement, [n].
        owner: which of ``captures`` it belongs to, [n].
        jacobian: change for one stated standard deviation of each parameter [m], [7, n].
        pins: change for each pin moved along x and y [m/m], [2 pins, n].
        warps: change for each linear warp of the picture, forward, then backward [m], [8, n].
        density: of the fabric [kg/m2]; NaN where it does not matter.
        grip: change from what the stated magnets hold to a point, or from a point to a patch [m], [n]; None
            where it is granted to each fabric as an error.
        sensed: mean square of the stated view's whitened errors that is the noise of pixels.
        calm_square: mean square of whitened residuals where nothing is there, over that with the usual errors.
        probes: by family, changes by weights and bends put on the cloth on trial, and by pins as ``pins`` [m or m/m],
            [probes, n]; empty where that was not looked at.
        setups: of each capture the number of its set-up; only those of one repeat each other. Empty: all are of one.
    """

    fabric: str
    scene: str
    captures: tuple[str, ...]
    stated: View
    wide: View
    cell: NDArray[np.intp]
    owner: NDArray[np.intp]
    jacobian: Array
    pins: Array
    warps: Array
    density: float = math.nan
    grip: Array | None = None
    sensed: float = 0.0
    calm_square: float = 1.0
    probes: Mapping[str, Array] = field(default_factory=dict)
    setups: tuple[int, ...] = ()

    @property
    def repeated(self) -> bool:
        """Some set-up was captured more than once."""
        return len(self.captures) > len(set(self.setups or (0,)))

    def repeats(self, values: Array) -> list[Array]:
        """Values by capture and cell of each set-up that was captured more than once, [captures, cells]; NaN: unseen.

        Args:
            values: one a measurement, [n].
        """
        table = np.full((len(self.captures), int(self.cell.max()) + 1), np.nan)
        table[self.owner, self.cell] = values
        setups = np.array(self.setups or [0] * len(self.captures))
        return [table[setups == one] for one in sorted(set(setups.tolist())) if (setups == one).sum() > 1]

    @property
    def views(self) -> tuple[View, View]:
        """Stated, then wide."""
        return (self.stated, self.wide)

    def metres(self, whitened: Array) -> Array:
        """From the stated view's units to metres, [n]."""
        return np.asarray(self.stated.factor @ whitened)


def make_block(
    captures: Sequence[CaptureResult], sigma: Sequence[float], model: NoiseModel, density: float = math.nan
) -> Block:
    """Stack the repeats of a fabric and scene and whiten them; the panel's plane is left to :class:`PixelBlock`.

    Args:
        captures: of one fabric in one scene.
        sigma: stated relative uncertainty of the seven parameters.
        model: all other errors.
        density: of the fabric [kg/m2], where effects that go with it are to be told apart.
    """
    measured = np.concatenate([c.measured.vector() for c in captures])
    on_plane = np.concatenate([np.arange(c.reference.length) >= c.reference.count for c in captures])
    seen = np.isfinite(measured) & ~on_plane
    stacked = {name: _stacked(captures, name)[:, seen] for name in captures[0].responses.effects}
    beside = {
        key: np.concatenate([c.responses.beside[key][0] for c in captures], axis=1)[:, seen]
        for key in _simulated_together(captures)
    }
    pixels = np.concatenate([np.concatenate([sensor_variance(c), np.zeros(len(PLANE_NAMES))]) for c in captures])
    sizes = [c.reference.length for c in captures]
    owner = np.repeat(np.arange(len(sizes)), sizes)[seen]
    wide = [max(s, model.wide_sigma) for s in sigma[:6]] + [sigma[6]]
    views = [
        _view(measured[seen], stacked, beside, owner, feature_covariance(captures, s, model)[np.ix_(seen, seen)])
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
        np.concatenate([c.responses.pins for c in captures], axis=1)[:, seen],
        np.concatenate([c.warps for c in captures], axis=1)[:, seen],
        density,
        np.concatenate([c.responses.grip for c in captures])[seen] if model.grip_alike else None,
        float(np.mean((whiten(views[0], np.diag(np.sqrt(pixels[seen]))) ** 2).sum(axis=0))),
        model.calm_square,
        {
            family: np.concatenate([c.responses.probes[family] for c in captures], axis=1)[:, seen]
            for family in captures[0].responses.probes
            if all(family in c.responses.probes for c in captures)
        },
        tuple(c.setup for c in captures),
    )


def _simulated_together(captures: Sequence[CaptureResult]) -> list[tuple[str, str]]:
    """Pairs that all of some captures were simulated with."""
    known = [c.responses.beside for c in captures]
    return [key for key in (known[0] if known else {}) if all(key in other for other in known)]


def _stacked(captures: Sequence[CaptureResult], name: str) -> Array:
    return np.concatenate([c.responses.effects[name][0] for c in captures], axis=1)


def _view(
    measured: Array,
    stacked: Mapping[str, Array],
    beside: Mapping[tuple[str, str], Array],
    owner: NDArray[np.intp],
    covariance: Array,
) -> View:
    from scipy.linalg import solve_triangular

    factor = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)

    def rows_whitened(rows: Array) -> Array:
        return np.asarray(solve_triangular(factor, rows.T, lower=True).T)

    responses, scatter = {}, {}
    for name, rows in stacked.items():
        if get_effect(name).random_repeats:
            scatter[name] = rows_whitened(np.concatenate([rows * (owner == k) for k in range(int(owner.max()) + 1)]))
        else:
            responses[name] = rows_whitened(rows)
    log_det = float(np.log(np.diag(factor)).sum())
    both = {key: rows_whitened(rows) for key, rows in beside.items()}
    return View(rows_whitened(measured[None])[0], responses, scatter, factor, log_det, both)


def whiten(view: View, columns: Array) -> Array:
    """Changes in metres, a column each, in a view's units, [n, columns]."""
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(view.factor, columns, lower=True))


@dataclass(frozen=True)
class PixelBlock:
    """What all captures share, each number in units of its own uncertainty: pixel statistics, the panel's plane.

    Attributes:
        measured: deviation from what the stated sensor and pose give, [m], NaN-free.
        responses: effect to its response at each node, [nodes, m].
        sensor_known: pixel statistics are among them.
        beside: (effect, other) to the effect's response at each node where the other one is there, too, [nodes, m].
        names: of the numbers, [m].
        taken: responses that were taken away from the measurements, [m] each; they are uncertain, too.
        vague: further variance of the measurements by what was taken away, [m].
    """

    measured: Array
    responses: dict[str, Array]
    sensor_known: bool
    beside: Mapping[tuple[str, str], Array] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    taken: tuple[Array, ...] = ()
    vague: Array | float = 0.0

    def vagueness(self, name: str) -> Array:
        """Standard deviation of what an effect of any size does to numbers that it changes as chance has it, [m]."""
        chance = np.isin(self.names, get_effect(name).vague) if self.names else np.zeros(len(self.measured), bool)
        return np.asarray(np.where(chance, np.abs(self.responses[name]).max(axis=0), 0.0))


def make_pixel_block(captures: Sequence[CaptureResult], model: NoiseModel) -> PixelBlock:
    """The median of each number over the captures that have it; camera and sensor are one for all.

    Pixel statistics count where the sensor is stated, the plane (offset and slopes) where the pose is. The former are
    taken in ``stretch`` where there is one: in ``hanging`` folds that fell elsewhere make edges, and noise across them.
    """
    deviation = np.stack([_deviation(c) for c in captures])
    seen = np.isfinite(deviation)
    folds = np.array([c.scene == "hanging" for c in captures])
    in_stretch = seen[~folds].any(axis=0) & (np.arange(seen.shape[1]) < len(PIXEL_NAMES))
    seen &= ~np.outer(folds, in_stretch)
    count = seen.sum(axis=0)
    usable = count > 0
    sigma = np.array([*model.pixel_sigma, *[model.plane_m] * len(PLANE_NAMES)])
    scale = sigma * np.sqrt(1.0 + 1.0 / np.maximum(count, 1))

    def common(values: Array) -> Array:
        """Median over captures (first axis) of what is usable, in units of its errors."""
        counted = np.where(np.expand_dims(seen, tuple(range(1, values.ndim - 1))), values, np.nan)
        return np.asarray(median_of_known(counted[..., usable]) / scale[usable])

    def of_nodes(rows: Sequence[tuple[Array, Array]]) -> Array:
        """Of all captures' responses (vectors, pixels), node by node."""
        return common(np.stack([np.concatenate([p, v[:, -len(PLANE_NAMES) :]], axis=1) for v, p in rows]))

    responses = {
        name: of_nodes([c.responses.effects[name] for c in captures]) for name in captures[0].responses.effects
    }
    where = [c for c in captures if not folds.all() and c.scene != "hanging"] or list(captures)
    beside = {}
    for key in _simulated_together(where):
        rows = [c.responses.beside.get(key, c.responses.effects[key[0]]) for c in captures]
        beside[key] = of_nodes(rows)
    names = tuple(name for name, there in zip((*PIXEL_NAMES, *PLANE_NAMES), usable, strict=True) if there)
    return PixelBlock(common(deviation), responses, any(c.sensor_known for c in captures), beside, names)


def median_of_known(values: Array) -> Array:
    """Median over the first axis of what is not NaN; NaN where nothing is.

    The same bits as ``numpy.nanmedian``, which takes six times as long for the few rows there are here.
    """
    ordered = np.sort(values, axis=0)  # NaN last
    count = (~np.isnan(ordered)).sum(axis=0)
    middle = [np.take_along_axis(ordered, np.maximum(at, 0)[None], axis=0)[0] for at in ((count - 1) // 2, count // 2)]
    return np.asarray(np.where(count > 0, 0.5 * (middle[0] + middle[1]), np.nan))


def _deviation(capture: CaptureResult) -> Array:
    pixels = capture.measured.pixels - capture.responses.sensed
    plane = capture.measured.plane
    return np.concatenate(
        [
            pixels if capture.sensor_known else np.full_like(pixels, np.nan),
            plane if capture.pose_known else np.full_like(plane, np.nan),
        ]
    )
