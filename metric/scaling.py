"""Fabrics in the plane by drape distance: classical multidimensional scaling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metric.matrix import DistanceMatrix


@dataclass(frozen=True)
class Scaling:
    """Points in few dimensions.

    Attributes:
        points: float64, shape [n, dimensions], in principal axes.
        explained: share of the positive part of the spectrum that these dimensions carry.
    """

    points: NDArray[np.float64]
    explained: float


def excess_distance(matrix: DistanceMatrix) -> NDArray[np.float64]:
    """Distance beyond the scatter of repeats: d(a, b) - (d(a, a) + d(b, b)) / 2, not below 0, symmetric, shape [n, n].

    For LPIPS, a squared Euclidean distance of features, this estimates the squared distance of the two fabrics' mean
    features without bias.
    """
    own = np.diag(matrix.distance)
    excess = (matrix.distance + matrix.distance.T) / 2.0 - (own[:, None] + own[None, :]) / 2.0
    np.fill_diagonal(excess, 0.0)
    clipped: NDArray[np.float64] = np.maximum(excess, 0.0)
    return clipped


def classical_scaling(squared: NDArray[np.float64], dimensions: int = 2) -> Scaling:
    """Points whose squared distances are as near as may be to the given ones (Torgerson 1952).

    Args:
        squared: symmetric, zero diagonal, shape [n, n].
        dimensions: of the points.
    """
    count = len(squared)
    centring = np.eye(count) - 1.0 / count
    values, vectors = np.linalg.eigh(-0.5 * centring @ squared @ centring)
    order = np.argsort(values)[::-1]
    positive = np.maximum(values[order], 0.0)
    points = vectors[:, order[:dimensions]] * np.sqrt(positive[:dimensions])
    total = float(positive.sum())
    return Scaling(points, float(positive[:dimensions].sum()) / total if total > 0 else 1.0)
