"""What the network is asked to predict, and back: standardised logarithms of the six parameters.

The parameters span four decades and are log-normal in the measured fabrics, hence logarithms and z-scores rather than
the paper's minimum and maximum (``docs/decisions/003-log-targets.md``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simcore.parameters import ESTIMATED_NAMES
from simcore.scenes import GRAVITY_M_S2
from trainer.config import Targets

FloatArray = NDArray[np.float64]
REFERENCE_SIZE_M = 0.5
STRETCH_COUNT = sum(name.startswith("stretch") for name in ESTIMATED_NAMES)
_LEAST_SPREAD = 0.05
"""Of a logarithm; fabrics that are all alike in something say little of how far others are from them."""


@dataclass(frozen=True)
class TargetScaling:
    """Statistics of the training materials.

    Attributes:
        targets: ``log``: ln p; ``log_per_weight``: ln(p / (g * density)), membrane [m], bending [m³].
        mean, spread: of those logarithms, shape [6].
        density_mean, density_spread: of ln(density / (kg/m²)).
        density_low, density_high: the lowest and the highest training density, in spreads from the mean; at least one
            spread away from it.
    """

    targets: Targets
    mean: tuple[float, ...]
    spread: tuple[float, ...]
    density_mean: float
    density_spread: float
    density_low: float
    density_high: float

    @classmethod
    def fit(cls, parameters: ArrayLike, targets: Targets) -> TargetScaling:
        """From the training materials' parameters, shape [materials, 7], SI."""
        values = np.asarray(parameters, dtype=np.float64)
        logs = _logs(values[:, :6], values[:, 6], targets)
        density = np.log(values[:, 6])
        density_spread = float(max(density.std(), _LEAST_SPREAD))
        return cls(
            targets,
            tuple(float(v) for v in logs.mean(axis=0)),
            tuple(float(v) for v in np.maximum(logs.std(axis=0), _LEAST_SPREAD)),
            float(density.mean()),
            density_spread,
            float(min((density.min() - density.mean()) / density_spread, -1.0)),
            float(max((density.max() - density.mean()) / density_spread, 1.0)),
        )

    def knowing(self, parameters: ArrayLike) -> TargetScaling:
        """The same for a network that learns from further materials, [materials, 7]: their densities are known."""
        further = self.encode_density(np.asarray(parameters, dtype=np.float64)[:, 6])
        low, high = min(self.density_low, float(further.min())), max(self.density_high, float(further.max()))
        return replace(self, density_low=low, density_high=high)

    def encode(self, parameters: ArrayLike) -> FloatArray:
        """Standardised targets, float64, shape [n, 6], of parameters [n, 7]."""
        values = np.asarray(parameters, dtype=np.float64)
        return np.asarray((_logs(values[:, :6], values[:, 6], self.targets) - self.mean) / self.spread)

    def encode_density(self, density: ArrayLike) -> FloatArray:
        """Standardised log-density, same shape as ``density`` [kg/m²]."""
        return np.asarray((np.log(np.asarray(density, dtype=np.float64)) - self.density_mean) / self.density_spread)

    def beyond(self, density: float) -> float:
        """How far a density [kg/m²] is from the training mean, in the same way's most extreme one."""
        place = float(self.encode_density(np.array(density)))
        return place / (self.density_high if place > 0.0 else self.density_low)

    def densities(self) -> tuple[float, float]:
        """The lowest and the highest density that counts as known [kg/m²], where :meth:`beyond` is 1."""
        low, high = (self.density_mean + end * self.density_spread for end in (self.density_low, self.density_high))
        return math.exp(low), math.exp(high)

    def decode(self, standardised: ArrayLike, density: ArrayLike) -> FloatArray:
        """Logarithms of the six parameters [ln SI], float64, shape [n, 6].

        Args:
            standardised: shape [n, 6].
            density: [kg/m²], shape [n].
        """
        logs = np.asarray(standardised, dtype=np.float64) * self.spread + self.mean
        if self.targets == "log_per_weight":
            logs = logs + np.log(np.asarray(density, dtype=np.float64) * GRAVITY_M_S2)[:, None]
        return np.asarray(logs)

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {
            "targets": self.targets,
            "mean": list(self.mean),
            "spread": list(self.spread),
            "density_mean": self.density_mean,
            "density_spread": self.density_spread,
            "density_low": self.density_low,
            "density_high": self.density_high,
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> TargetScaling:
        """Back from :meth:`to_json`; models of earlier versions know how far their densities went, not which way."""
        limit = values.get("density_limit")
        return cls(
            values["targets"],
            tuple(values["mean"]),
            tuple(values["spread"]),
            values["density_mean"],
            values["density_spread"],
            values["density_low"] if limit is None else -limit,
            values["density_high"] if limit is None else limit,
        )


def _logs(parameters: FloatArray, density: FloatArray, targets: Targets) -> FloatArray:
    logs = np.log(parameters)
    if targets == "log_per_weight":
        logs = logs - np.log(density * GRAVITY_M_S2)[:, None]
    return np.asarray(logs)


def similarity_shift(size_m: float) -> FloatArray:
    """What to add to the log-parameters read from a sample that is not 0.5 m, shape [6].

    A static drape depends on k / (rho g L) and B / (rho g L³) alone. A sample of edge L that, shrunk or grown to the
    reference of 0.5 m, looks like a reference sample of the same density and parameters k0, B0 has therefore
    k = k0 (L / 0.5 m) and B = B0 (L / 0.5 m)³.
    """
    ratio = np.log(size_m / REFERENCE_SIZE_M)
    powers = np.array([1.0] * STRETCH_COUNT + [3.0] * (len(ESTIMATED_NAMES) - STRETCH_COUNT))
    return np.asarray(powers * ratio)
