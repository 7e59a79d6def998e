"""90 % intervals by split conformal prediction on materials that were never learnt from.

The network's own spread says where it is unsure; the conformal factor makes intervals of that shape cover. Factors are
kept apart for each set of scenes, since two scenes tell more than one (Lei et al. 2018, split conformal inference with
locally weighted residuals).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trainer.network import OUTPUTS

FloatArray = NDArray[np.float64]
LEVEL = 0.9


@dataclass(frozen=True)
class IntervalTable:
    """Half-widths of the intervals in units of the predicted spread.

    Attributes:
        factors: scene set, as :func:`scene_key` -> factor for each of the six targets; ``inf`` where the calibration
            materials are too few to promise anything.
        materials: scene set -> number of calibration materials.
    """

    factors: dict[str, tuple[float, ...]]
    materials: dict[str, int]

    def half_widths(self, scenes: tuple[str, ...], spread: FloatArray) -> FloatArray:
        """Half-widths of the standardised targets, same shape as ``spread`` [n, 6]."""
        return np.asarray(spread * np.asarray(self.factors[scene_key(scenes)]))

    def promises(self, scenes: Iterable[str]) -> bool:
        """Whether the intervals of this set of scenes were calibrated on enough materials to hold what they promise."""
        return all(map(math.isfinite, self.factors[scene_key(tuple(scenes))]))

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values; an infinite factor is null."""
        factors = {key: [f if math.isfinite(f) else None for f in row] for key, row in self.factors.items()}
        return {"level": LEVEL, "factors": factors, "materials": self.materials}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> IntervalTable:
        """Back from :meth:`to_json`."""
        factors = {
            key: tuple(math.inf if f is None else float(f) for f in row) for key, row in values["factors"].items()
        }
        return cls(factors, dict(values["materials"]))


def scene_key(scenes: tuple[str, ...]) -> str:
    """Name of a set of scenes: sorted and joined by ``+``."""
    return "+".join(sorted(scenes))


def conformal_factors(residuals: FloatArray, spread: FloatArray, materials: NDArray[np.int64]) -> tuple[float, ...]:
    """Factors by which the spread must be multiplied to cover :data:`LEVEL` of new materials.

    Pictures of one material are not independent: each material weighs the same, whatever the number of its pictures,
    and the finite-sample correction (n + 1) / n counts materials.

    Args:
        residuals: truth minus prediction, standardised, shape [n, 6].
        spread: predicted spread, shape [n, 6].
        materials: material of each prediction, shape [n].

    Returns:
        Six factors; ``inf`` when fewer than nine materials were held out.
    """
    unique, index, counts = np.unique(materials, return_inverse=True, return_counts=True)
    if not len(unique):
        return (math.inf,) * OUTPUTS
    needed = LEVEL * (len(unique) + 1) / len(unique)
    if needed > 1.0:
        return (math.inf,) * OUTPUTS
    weights = 1.0 / counts[index] / len(unique)
    scores = np.abs(residuals) / spread
    return tuple(_weighted_quantile(scores[:, k], weights, needed) for k in range(OUTPUTS))


def _weighted_quantile(values: FloatArray, weights: FloatArray, share: float) -> float:
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weights[order])
    position = int(np.searchsorted(cumulative, share - 1e-9))
    return float(values[order[min(position, len(values) - 1)]])
