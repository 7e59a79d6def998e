"""Do participants agree, and does a metric agree with them?"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from metric.triplets import Answer
from metric.tste import answer_array, embed
from simcore.errors import InputError


@dataclass(frozen=True)
class Agreement:
    """How often two participants answer the same question alike.

    Attributes:
        share: mean over questions of the share of pairs of participants that chose the same fabric; None where no
            question was answered twice. Chance is 0.5.
        questions: questions answered by at least two participants.
        pairs: pairs of answers compared.
    """

    share: float | None
    questions: int
    pairs: int


@dataclass(frozen=True)
class MetricAgreement:
    """How well a metric orders fabrics as people do.

    Attributes:
        per_fabric: Spearman correlation of each reference fabric's ranking with that of the embedding, shape [n]; NaN
            of a fabric that no answer names, or whose distances are not known, which ranks nowhere.
        mean: their mean.
        interval_95: ``mean`` give or take 1.96 standard deviations of it over resamples of the participants, the
            embedding fitted anew each time, within -1 to 1; None where not asked. (Resamples correlate less than the
            answers do, so that their own quantiles would lie too low.) It is of studies like this one: few answers make
            an embedding that correlates less than the truth does.
        answers_predicted: share of the raw answers, all of whose distances are known, in which the metric puts the
            chosen fabric nearer; NaN where there are none.
    """

    per_fabric: NDArray[np.float64]
    mean: float
    interval_95: tuple[float, float] | None
    answers_predicted: float


def agreement(answers: Sequence[Answer]) -> Agreement:
    """Agreement between participants over questions that several of them answered."""
    votes: dict[tuple[int, int, int], dict[str, int]] = defaultdict(dict)
    for answer in answers:
        votes[answer.triplet.question][answer.participant] = answer.chosen
    shares, pairs = [], 0
    for choices in votes.values():
        count = len(choices)
        if count < 2:
            continue
        first = sum(chosen == min(choices.values()) for chosen in choices.values())
        alike = first * (first - 1) + (count - first) * (count - first - 1)
        shares.append(alike / (count * (count - 1)))
        pairs += count * (count - 1) // 2
    return Agreement(float(np.mean(shares)) if shares else None, len(shares), pairs)


def rank_correlations(distance: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Spearman correlation, for each fabric, of the ranking of all others by two distances.

    Args:
        distance, reference: shape [n, n]; diagonals are not read.

    Returns:
        float64, shape [n]; NaN where a ranking has no order at all.

    Raises:
        InputError: other shapes, or fewer than 3 fabrics.
    """
    if distance.shape != reference.shape or distance.ndim != 2 or distance.shape[0] < 3:
        raise InputError(
            f"two distance matrices of the same 3 or more fabrics are needed, got {distance.shape} and "
            f"{reference.shape}",
            code="matrices_differ",
        )
    count = len(distance)
    found = np.full(count, np.nan)
    for row in range(count):
        others = np.arange(count) != row
        x, y = rankdata(distance[row, others]), rankdata(reference[row, others])
        if x.std() > 0 and y.std() > 0:
            found[row] = np.corrcoef(x, y)[0, 1]
    return found


def metric_agreement(
    matrices: Mapping[str, NDArray[np.float64]],
    answers: Sequence[Answer],
    fabrics: int,
    *,
    dimensions: int = 2,
    bootstrap: int = 200,
    seed: int = 0,
) -> dict[str, MetricAgreement]:
    """Spearman correlation of each metric's rankings with those of the answers' tSTE embedding.

    Participants are drawn with replacement for the interval, and the embedding is fitted anew from the full one.

    Args:
        matrices: distances of each metric, shape [n, n], by name; rows and columns of NaN where a fabric's are not
            known.
        answers: of all participants.
        fabrics: number of fabrics n.
        dimensions: of the embedding.
        bootstrap: resamples; 0 for no interval, nor is there one of a single participant.
        seed: of the starts and resamples.

    Raises:
        InputError: no answers, or a matrix of another size.
    """
    triplets = answer_array(answers)
    whole = embed(triplets, fabrics, dimensions=dimensions, seed=seed)
    named = np.isin(np.arange(fabrics), triplets)
    several = len({answer.participant for answer in answers}) > 1  # of one person nothing can be drawn again
    resampled = _resampled_distances(answers, fabrics, whole.points, bootstrap if several else 0, seed)
    found = {}
    for name, matrix in matrices.items():
        per_fabric = _correlations(matrix, whole.distances, named)
        mean = _mean(per_fabric)
        means = [again for d, known in resampled if not np.isnan(again := _mean(_correlations(matrix, d, known)))]
        interval = _normal_interval(mean, means) if len(means) > 1 else None
        reference, chosen, rejected = triplets.T
        nearer = matrix[reference, chosen] - matrix[reference, rejected]
        predicted = _mean(np.where(np.isnan(nearer), np.nan, np.where(nearer == 0, 0.5, nearer < 0)))
        found[name] = MetricAgreement(per_fabric, mean, interval, predicted)
    return found


def _correlations(
    distance: NDArray[np.float64], reference: NDArray[np.float64], named: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """:func:`rank_correlations` among the fabrics that answers name, bool [n], and whose distances are known; NaN of
    others, which lie anywhere."""
    if distance.shape != reference.shape:
        return rank_correlations(distance, reference)
    ranked = named & (np.isfinite(distance) & ~np.eye(len(distance), dtype=bool)).any(axis=1)
    if ranked.all():
        return rank_correlations(distance, reference)
    found = np.full(len(ranked), np.nan)
    if np.count_nonzero(ranked) >= 3:
        found[ranked] = rank_correlations(distance[np.ix_(ranked, ranked)], reference[np.ix_(ranked, ranked)])
    return found


def _normal_interval(estimate: float, resampled: Sequence[float]) -> tuple[float, float]:
    half = 1.96 * float(np.std(resampled, ddof=1))
    return max(-1.0, estimate - half), min(1.0, estimate + half)


def _mean(values: NDArray[np.float64]) -> float:
    """Mean of the numbers among them; NaN where there is none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def _resampled_distances(
    answers: Sequence[Answer], fabrics: int, start: NDArray[np.float64], count: int, seed: int
) -> list[tuple[NDArray[np.float64], NDArray[np.bool_]]]:
    """Distances in embeddings of answers drawn anew, [n, n], and which fabrics those answers name, bool [n]."""
    by_participant: dict[str, list[Answer]] = defaultdict(list)
    for answer in answers:
        by_participant[answer.participant].append(answer)
    groups = [answer_array(group) for group in by_participant.values()]
    rng = np.random.default_rng((seed, 1))
    found = []
    for _ in range(count):
        drawn = np.concatenate([groups[i] for i in rng.integers(0, len(groups), len(groups))])
        again = embed(drawn, fabrics, dimensions=start.shape[1], restarts=1, start=start, seed=seed)
        found.append((again.distances, np.isin(np.arange(fabrics), drawn)))
    return found
