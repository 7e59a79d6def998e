"""t-distributed stochastic triplet embedding (van der Maaten and Weinberger 2012)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from metric.triplets import Answer
from simcore.errors import InputError


@dataclass(frozen=True)
class Embedding:
    """Points whose distances explain the answers.

    Attributes:
        points: float64, shape [n, dimensions], centred, in principal axes; only distances mean something.
        log_likelihood: mean log-probability of an answer; log(1/2) is chance.
    """

    points: NDArray[np.float64]
    log_likelihood: float

    @property
    def distances(self) -> NDArray[np.float64]:
        """Euclidean distance of every pair, shape [n, n]."""
        found: NDArray[np.float64] = np.linalg.norm(self.points[:, None] - self.points[None, :], axis=2)
        return found


def answer_array(answers: Sequence[Answer]) -> NDArray[np.int64]:
    """Rows of reference, chosen and rejected fabric, int64, shape [m, 3]."""
    return np.array([(a.triplet.reference, a.chosen, a.rejected) for a in answers], np.int64).reshape(-1, 3)


def embed(
    triplets: NDArray[np.int64],
    fabrics: int,
    *,
    dimensions: int = 2,
    alpha: float | None = None,
    penalty: float = 1e-3,
    restarts: int = 8,
    seed: int = 0,
    start: NDArray[np.float64] | None = None,
) -> Embedding:
    """Points under which the answers are most probable.

    An answer "i is more like j than like k" has probability s_ij / (s_ij + s_ik) with the Student-t similarity
    s_ij = (1 + |x_i - x_j|² / alpha)^(-(alpha + 1) / 2). The best of several random starts, by L-BFGS.

    Args:
        triplets: rows (i, j, k), int64, shape [m, 3].
        fabrics: number of points n.
        dimensions: of the points.
        alpha: degrees of freedom; by default dimensions - 1, at least 1.
        penalty: weight of the mean squared length of the points, which keeps unanimous answers from pushing points to
            infinity.
        restarts: random starts.
        seed: of the starts.
        start: a first start, shape [n, dimensions].

    Raises:
        InputError: no answers, or an index outside the fabrics.
    """
    if len(triplets) == 0:
        raise InputError("an embedding needs answers: none were given yet", code="answers_missing")
    if triplets.min() < 0 or triplets.max() >= fabrics:
        raise InputError("an answer names a fabric that is not in the study", code="answer_fabric_unknown")
    freedom = float(max(dimensions - 1, 1)) if alpha is None else alpha
    rng = np.random.default_rng(seed)
    starts = [] if start is None else [start]
    starts += [rng.normal(0, 0.5, (fabrics, dimensions)) for _ in range(max(restarts - len(starts), 0))]
    best = min(
        (
            minimize(
                _loss,
                x0.ravel(),
                args=(triplets, fabrics, freedom, penalty),
                jac=True,
                method="L-BFGS-B",
                options={"maxiter": 500},
            )
            for x0 in starts
        ),
        key=lambda found: float(found.fun),
    )
    points = best.x.reshape(fabrics, dimensions)
    points = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(points, full_matrices=False)
    likelihood = -_loss(best.x, triplets, fabrics, freedom, 0.0)[0]
    return Embedding(points @ axes.T, likelihood)


def _loss(
    flat: NDArray[np.float64], triplets: NDArray[np.int64], fabrics: int, alpha: float, penalty: float
) -> tuple[float, NDArray[np.float64]]:
    """Mean negative log-likelihood plus penalty, and its gradient."""
    points = flat.reshape(fabrics, -1)
    i, j, k = triplets.T
    to_j, to_k = points[i] - points[j], points[i] - points[k]
    base_j, base_k = 1.0 + np.sum(to_j**2, axis=1) / alpha, 1.0 + np.sum(to_k**2, axis=1) / alpha
    power = (alpha + 1.0) / 2.0
    # log p = -log(1 + (base_j / base_k)^power)
    logit = power * (np.log(base_k) - np.log(base_j))
    loss = float(np.mean(np.logaddexp(0.0, -logit)))
    weight = -1.0 / (1.0 + np.exp(np.clip(logit, -700, 700))) / len(triplets)  # d loss / d logit
    grad_j = (weight * -power / base_j * 2.0 / alpha)[:, None] * to_j
    grad_k = (weight * power / base_k * 2.0 / alpha)[:, None] * to_k
    gradient = np.zeros_like(points)
    np.add.at(gradient, i, grad_j + grad_k)
    np.add.at(gradient, j, -grad_j)
    np.add.at(gradient, k, -grad_k)
    size = points.size
    loss += penalty * float(np.sum(points**2)) / size
    gradient += 2.0 * penalty * points / size
    return loss, gradient.ravel()
