"""Simulated observers: they check the study's analysis and are never counted as people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metric.triplets import Triplet


def observer_stream(seed: int, observer: int) -> np.random.Generator:
    """Random numbers of one observer, by number, of a seed's."""
    return np.random.default_rng((seed, 1, observer))


def simulate_answers(
    questions: Sequence[Triplet], distances: NDArray[np.float64], rng: np.random.Generator, *, noise: float
) -> list[int]:
    """Choices of an observer who sees each distance with relative noise; infinite noise is a coin.

    Args:
        questions: in the order in which they are answered.
        distances: what the observer would see without noise, shape [n, n].
        rng: random numbers, of :func:`observer_stream`.
        noise: standard deviation of the logarithm of a seen distance.

    Returns:
        The chosen fabric of each question.
    """
    return [_choice(triplet, distances, rng, noise) for triplet in questions]


def _choice(triplet: Triplet, distances: NDArray[np.float64], rng: np.random.Generator, noise: float) -> int:
    if np.isinf(noise):
        return triplet.left if rng.random() < 0.5 else triplet.right
    seen = {
        side: float(np.log(max(distances[triplet.reference, side], 1e-12)) + noise * rng.normal())
        for side in (triplet.left, triplet.right)
    }
    return min(seen, key=lambda side: seen[side])
