"""Simulated observers: they check the study's analysis and are never counted as people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metric.triplets import Answer, Triplet, draw_triplets, shared_triplets


def simulate_answer(triplet: Triplet, distances: NDArray[np.float64], rng: np.random.Generator, *, noise: float) -> int:
    """Choice of an observer who sees each distance with relative noise; infinite noise is a coin.

    Args:
        triplet: the question.
        distances: what the observer would see without noise, shape [n, n].
        rng: random numbers.
        noise: standard deviation of the logarithm of a seen distance.

    Returns:
        The chosen fabric.
    """
    if np.isinf(noise):
        return triplet.left if rng.random() < 0.5 else triplet.right
    seen = {
        side: float(np.log(max(distances[triplet.reference, side], 1e-12)) + noise * rng.normal())
        for side in (triplet.left, triplet.right)
    }
    return min(seen, key=lambda side: seen[side])


def simulate_observers(
    distances: NDArray[np.float64],
    observers: int,
    *,
    seed: int = 0,
    noise: float = 0.3,
    count: int = 20,
    shared: int = 5,
) -> list[Answer]:
    """Answers of several simulated observers of one known set of distances, each marked ``simulated``.

    Args:
        distances: the truth, shape [n, n].
        observers: how many.
        seed: of all random numbers.
        noise: as for :func:`simulate_answer`.
        count: questions an observer.
        shared: of these, questions put to all.
    """
    fabrics = len(distances)
    common: Sequence[Triplet] = shared_triplets(fabrics, np.random.default_rng((seed, 0)), shared)
    answers = []
    for observer in range(observers):
        rng = np.random.default_rng((seed, 1, observer))
        for triplet in draw_triplets(fabrics, rng, count=count, shared=common):
            chosen = simulate_answer(triplet, distances, rng, noise=noise)
            answers.append(Answer(f"simulated-{observer}", triplet, chosen, simulated=True))
    return answers
