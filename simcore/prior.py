"""The distribution of real fabrics in the space of the seven parameters, and samples of it.

Sources of the numbers:

* density and the three bendings: means and covariances of the logarithms over the 618 fabrics published with Feng,
  Huang, Xu and Wang, "Learning-Based Bending Stiffness Parameter Estimation by a Drape Tester" (SIGGRAPH Asia 2022);
* stretch: medians, spreads and extremes of the ten fabrics of Wang, O'Brien and Ramamoorthi, "Data-Driven Elastic
  Models for Cloth" (SIGGRAPH 2011). Ten fabrics fix no correlation (they give 0.91 between warp and weft, 0.26 and 0.30
  with bias); rounder ones are used, and the spread of the bias stiffness is widened from 0.67 to 1.0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from simcore.bending import ADMISSIBLE
from simcore.errors import InputError
from simcore.parameters import LIMITS, PARAMETER_NAMES, FabricParameters
from simcore.sampling import SobolDesign, UnitDesign

ADMISSIBLE_MARGIN = 1.1
"""4 B_bias is kept at least this much above (sqrt(B_warp) - sqrt(B_weft))^2, where a plate loses its stability."""

MAX_ATTEMPTS = 2048
"""Proposals an index gets before its ranges are called empty (the default prior accepts three of four)."""

# Order of PARAMETER_NAMES: stretch warp, weft, bias; bending warp, weft, bias; density.
_LOG_MEAN = (5.27, 5.71, 3.61, -11.2846, -11.6913, -11.5088, -1.7894)
_STRETCH_LOG_STD = (1.81, 2.02, 1.0)
_STRETCH_CORRELATION = ((1.0, 0.8, 0.5), (0.8, 1.0, 0.5), (0.5, 0.5, 1.0))
_BENDING_DENSITY_LOG_COV = (
    (1.9774, 1.5031, 1.6345, 0.8126),
    (1.5031, 1.5632, 1.4006, 0.7226),
    (1.6345, 1.4006, 1.6669, 0.7897),
    (0.8126, 0.7226, 0.7897, 0.6504),
)
DEFAULT_RANGES: dict[str, tuple[float, float]] = {
    # The ten fabrics' extremes, widened.
    "stretch_warp": (15.0, 6000.0),
    "stretch_weft": (6.0, 6000.0),
    "stretch_bias": (9.0, 500.0),
    # From the first percentile of the 618, widened by 1.25, to about three standard deviations above the mean.
    "bending_warp": (6.5e-7, 5e-4),
    "bending_weft": (3.7e-7, 5e-4),
    "bending_bias": (3.7e-7, 5e-4),
    # First and last percentile, widened by 1.25.
    "density": (0.017, 0.865),
}
"""Where the prior is cut off [SI]."""


def _default_log_cov() -> NDArray[np.float64]:
    cov = np.zeros((7, 7))
    std = np.asarray(_STRETCH_LOG_STD)
    cov[:3, :3] = np.asarray(_STRETCH_CORRELATION) * np.outer(std, std)
    cov[3:, 3:] = _BENDING_DENSITY_LOG_COV
    return cov


def is_admissible(values: NDArray[np.float64], margin: float = ADMISSIBLE_MARGIN) -> NDArray[np.bool_]:
    """Whether a plate with these bending rigidities is stable with some margin (``docs/decisions/001``), and has the
    bias rigidity that is stated: :class:`~simcore.bending.PlateRigidity` raises none of them.

    Args:
        values: fabric parameters, SI, shape [N, 7].
        margin: factor on the least ``4 bending_bias``.

    Returns:
        bool, shape [N].
    """
    warp, weft, bias = values[:, 3], values[:, 4], values[:, 5]
    stated = 4.0 * bias - warp - weft >= -2.0 * ADMISSIBLE * np.sqrt(warp * weft)
    return np.asarray((4.0 * bias >= margin * (np.sqrt(warp) - np.sqrt(weft)) ** 2) & stated)


@dataclass(frozen=True)
class FabricPrior:
    """Truncated joint log-normal of the seven fabric parameters.

    Attributes:
        log_mean: mean of the natural logarithms, order of ``PARAMETER_NAMES``, SI.
        log_cov: their covariance, shape [7, 7].
        ranges: lowest and highest value of each parameter, SI.
    """

    log_mean: tuple[float, ...]
    log_cov: tuple[tuple[float, ...], ...]
    ranges: dict[str, tuple[float, float]]

    @classmethod
    def default(cls, ranges: Mapping[str, tuple[float, float]] | None = None) -> FabricPrior:
        """The prior of real fabrics, cut off at :data:`DEFAULT_RANGES` or, where given, at other ranges.

        Raises:
            InputError: an unknown parameter, a range upside down or outside what any textile has.
        """
        merged = {**DEFAULT_RANGES, **check_ranges(ranges or {})}
        cov = tuple(tuple(float(v) for v in row) for row in _default_log_cov())
        return cls(_LOG_MEAN, cov, {name: merged[name] for name in PARAMETER_NAMES})

    @cached_property
    def _low_high(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        pairs = np.array([self.ranges[name] for name in PARAMETER_NAMES])
        return pairs[:, 0], pairs[:, 1]

    @cached_property
    def _factor(self) -> NDArray[np.float64]:
        return np.linalg.cholesky(np.asarray(self.log_cov))

    def transform(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """From the unit cube to fabrics by the correlated normal copula, before any cut, float64, shape [N, 7]."""
        # A matrix product's rounding depends on its shape; this sum does not, so one index alone gives the same bits.
        normals = norm.ppf(points)
        return np.asarray(np.exp(np.asarray(self.log_mean) + (normals[:, None, :] * self._factor[None]).sum(axis=2)))

    def accepts(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether fabrics lie inside the ranges and are admissible plates, bool, shape [N]."""
        low, high = self._low_high
        inside = ((values >= low) & (values <= high)).all(axis=1)
        return np.asarray(inside & is_admissible(values))

    def sample_array(
        self, indices: Sequence[int] | NDArray[np.int64], seed: int = 0, design: UnitDesign | None = None
    ) -> NDArray[np.float64]:
        """Fabrics of the given indices, float64, SI, shape [N, 7].

        A fabric depends on ``seed``, the design and its own index, never on which others are asked for with it. Where
        the proposal of an index is cut off, the same index of the next independent sequence is taken: every accepted
        value follows the truncated distribution exactly.

        Args:
            indices: which samples of the sequence.
            seed: seed of the default design, scrambled Sobol.
            design: another design.

        Raises:
            InputError: a negative index, or ranges so narrow that hardly any fabric falls into them.
        """
        numbers = np.asarray(indices, dtype=np.int64).ravel()
        chosen: UnitDesign = SobolDesign(seed) if design is None else design
        values = np.empty((len(numbers), 7))
        missing = np.arange(len(numbers))
        for attempt in range(MAX_ATTEMPTS):
            proposal = self.transform(chosen.points(numbers[missing], attempt))
            accepted = self.accepts(proposal)
            values[missing[accepted]] = proposal[accepted]
            missing = missing[~accepted]
            if not len(missing):
                return values
        raise InputError(
            f"fewer than one fabric in {MAX_ATTEMPTS} falls into the ranges: widen them, or give the fabrics as a list",
            code="ranges_empty",
        )

    def sample(
        self, indices: Sequence[int] | NDArray[np.int64], seed: int = 0, design: UnitDesign | None = None
    ) -> list[FabricParameters]:
        """As :meth:`sample_array`, as objects."""
        return [FabricParameters.from_array(row) for row in self.sample_array(indices, seed, design)]


def check_ranges(ranges: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """The same ranges if they are usable.

    Raises:
        InputError: an unknown parameter, a range upside down or outside what any textile has.
    """
    for name, (low, high) in ranges.items():
        if name not in LIMITS:
            raise InputError(
                f"unknown parameter {name!r} in a range: choose from {', '.join(PARAMETER_NAMES)}", code="range_unknown"
            )
        if not low < high:
            raise InputError(
                f"range of {name} runs from {low:g} to {high:g}: the first number must be the smaller",
                code="range_order",
            )
        least, most = LIMITS[name]
        if not (least <= low and high <= most):
            raise InputError(
                f"range of {name}, {low:g} to {high:g}, leaves {least:g} to {most:g}: give SI units",
                code="range_limits",
            )
    return dict(ranges)
