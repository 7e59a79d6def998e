"""Is a capture like what the network has learnt from? A score per picture, 1 at the border.

Two descriptions of a picture are compared with the training pictures of its scene: the network's features, and plain
statistics of the heights that equalisation hides from the network (cloth area, extent, relief, roughness). Each is
modelled by a Gaussian in its principal directions (Lee et al. 2018); what the principal directions leave over counts
apart. Borders are quantiles of pictures of held-out materials.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from trainer.preprocess import HEIGHT_SCALE_M, cloth_mask

FloatArray = NDArray[np.float64]
BORDER_QUANTILE = 0.995
MAX_DIRECTIONS = 24
_LEAST_FEATURE_SPREAD = 0.01
_LEAST_STATISTICS_SPREAD = 0.01
"""Floors of the spread, so that what happened to be constant in training is no trap: of the features as a share of
their largest spread, of the statistics as they are."""
_TINY = 1e-9


@dataclass(frozen=True)
class GaussianReference:
    """Gaussian in the leading principal directions, with the spread of what is left over.

    Attributes:
        mean: shape [d]. basis: shape [k, d], orthonormal. spread: along the basis, shape [k].
        left_over: RMS length of what the basis leaves, scalar array.
    """

    mean: FloatArray
    basis: FloatArray
    spread: FloatArray
    left_over: FloatArray

    @classmethod
    def fit(cls, samples: FloatArray, *, floor: float = 0.0, floor_share: float = 0.0) -> GaussianReference:
        """From samples, shape [n, d].

        Args:
            floor, floor_share: least spread along a direction, as such and as a share of the largest.
        """
        mean = samples.mean(axis=0)
        centred = samples - mean
        _, values, rows = np.linalg.svd(centred, full_matrices=False)
        count = max(1, min(MAX_DIRECTIONS, len(samples) // 4, samples.shape[1]))
        spread = values[:count] / np.sqrt(len(samples))
        least = max(floor, floor_share * float(spread[0]), _TINY)
        rest = centred - (centred @ rows[:count].T) @ rows[:count]
        left_over = np.maximum(np.sqrt((rest**2).sum(axis=1).mean()), least)
        return cls(mean, rows[:count], np.maximum(spread, least), np.asarray(left_over))

    def distances(self, samples: FloatArray) -> FloatArray:
        """RMS whitened distance within the directions and relative length left over, shape [n, 2]."""
        centred = samples - self.mean
        inside = centred @ self.basis.T
        rest = np.sqrt(((centred - inside @ self.basis) ** 2).sum(axis=1)) / self.left_over
        return np.stack([np.sqrt(((inside / self.spread) ** 2).mean(axis=1)), rest], axis=1)

    def arrays(self) -> dict[str, FloatArray]:
        """Named arrays for storage."""
        return {"mean": self.mean, "basis": self.basis, "spread": self.spread, "left_over": self.left_over}


@dataclass(frozen=True)
class OutlierModel:
    """Reference of one scene.

    Attributes:
        features, statistics: the two descriptions.
        borders: distance that counts as 1, for (features inside, features left over, statistics inside, left over).
    """

    features: GaussianReference
    statistics: GaussianReference
    borders: FloatArray

    @classmethod
    def fit(
        cls,
        features: FloatArray,
        statistics: FloatArray,
        held_out_features: FloatArray,
        held_out_statistics: FloatArray,
    ) -> OutlierModel:
        """From the descriptions of training pictures and of pictures of held-out materials, each [n, d]."""
        model = cls(
            GaussianReference.fit(features, floor_share=_LEAST_FEATURE_SPREAD),
            GaussianReference.fit(statistics, floor=_LEAST_STATISTICS_SPREAD),
            np.ones(4),
        )
        distances = model.scores(held_out_features, held_out_statistics)
        borders = np.quantile(distances, BORDER_QUANTILE, axis=0)
        return cls(model.features, model.statistics, np.maximum(borders, 1.0))

    def scores(self, features: FloatArray, statistics: FloatArray) -> FloatArray:
        """The four distances over their borders, shape [n, 4]; above 1 is outside."""
        both = np.concatenate([self.features.distances(features), self.statistics.distances(statistics)], axis=1)
        return np.asarray(both / self.borders)

    def to_tensors(self, prefix: str) -> dict[str, Tensor]:
        """Named tensors for storage."""
        named = {f"{prefix}.features.{k}": v for k, v in self.features.arrays().items()}
        named |= {f"{prefix}.statistics.{k}": v for k, v in self.statistics.arrays().items()}
        named[f"{prefix}.borders"] = self.borders
        return {key: torch.from_numpy(np.ascontiguousarray(value, dtype=np.float32)) for key, value in named.items()}

    @classmethod
    def from_tensors(cls, prefix: str, tensors: dict[str, Tensor]) -> OutlierModel:
        """Back from :meth:`to_tensors`."""

        def reference(name: str) -> GaussianReference:
            keys = ("mean", "basis", "spread", "left_over")
            return GaussianReference(*(_float64(tensors[f"{prefix}.{name}.{key}"]) for key in keys))

        return cls(reference("features"), reference("statistics"), _float64(tensors[f"{prefix}.borders"]))

    def stored(self) -> OutlierModel:
        """The same after rounding to what is stored."""
        return OutlierModel.from_tensors("x", self.to_tensors("x"))


def picture_statistics(pictures: Tensor) -> FloatArray:
    """Plain statistics of pictures, float64, shape [pictures, 9].

    Area of the cloth that stands off the panel, extent of its inner 98 % along both axes, its mean height and heights
    at 5, 50 and 95 %, its mean slope, share of border pixels.

    Args:
        pictures: heights [m], float32, shape [pictures, 1, H, W].
    """
    cloth = cloth_mask(pictures)
    rows = [_statistics_of(p[0], m[0]) for p, m in zip(pictures.double().numpy(), cloth.numpy(), strict=True)]
    return np.array(rows).reshape(len(rows), 9)


def _statistics_of(height: FloatArray, cloth: NDArray[np.bool_]) -> list[float]:
    if not cloth.any():
        return [0.0] * 9
    places = np.argwhere(cloth) / len(cloth)
    extent = [float(e) for e in np.diff(np.quantile(places, (0.01, 0.99), axis=0), axis=0)[0]]
    inside = cloth.copy()
    inside[1:] &= cloth[:-1]
    inside[:, 1:] &= cloth[:, :-1]
    slope_v, slope_u = np.diff(height, axis=0, prepend=0)[inside], np.diff(height, axis=1, prepend=0)[inside]
    slope = float(np.hypot(slope_u, slope_v).mean()) * len(cloth) if inside.any() else 0.0
    relief = [float(height[cloth].mean()), *(float(q) for q in np.quantile(height[cloth], (0.05, 0.5, 0.95)))]
    border = 1.0 - float(inside.sum() / cloth.sum())
    return [float(cloth.mean()), *extent, *(r / HEIGHT_SCALE_M for r in relief), float(np.log(slope + 1e-3)), border]


def _float64(tensor: Tensor) -> FloatArray:
    return np.asarray(tensor.numpy(), dtype=np.float64)
