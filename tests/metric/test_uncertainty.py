"""The standard error is right when samples are drawn again and again."""

from __future__ import annotations

import numpy as np
import pytest

from metric.uncertainty import mean_and_error, self_mean_and_error


def squared_distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum((a[:, None, :] - b[None, :, :]) ** 2, axis=2)


def test_two_sample_error_matches_the_scatter_of_repeats() -> None:
    rng = np.random.default_rng(0)
    means, variances = [], []
    for _ in range(3000):
        table = squared_distances(rng.normal(0, 1, (5, 4)), rng.normal(0.5, 2, (5, 4)))
        mean, error = mean_and_error(table)
        assert error is not None
        means.append(mean)
        variances.append(error**2)
    assert np.mean(variances) == pytest.approx(np.var(means), rel=0.1)


def test_naive_error_would_be_too_small() -> None:
    """Counting the N² entries as independent is the mistake that the estimate avoids."""
    rng = np.random.default_rng(1)
    table = squared_distances(rng.normal(0, 1, (5, 4)), rng.normal(0, 1, (5, 4)) + 1)
    _, error = mean_and_error(table)
    assert error is not None
    assert error > 1.3 * table.std(ddof=1) / 5


def test_self_distance_error_matches_the_scatter_of_repeats() -> None:
    rng = np.random.default_rng(2)
    means, variances = [], []
    for _ in range(3000):
        sample = rng.normal(0, 1, (6, 4))
        mean, error = self_mean_and_error(squared_distances(sample, sample))
        assert error is not None
        means.append(mean)
        variances.append(error**2)
    assert np.mean(means) == pytest.approx(8.0, rel=0.02)  # 2 x variance x dimensions: no render against itself
    assert 1.0 < np.mean(variances) / np.var(means) < 1.4  # the jackknife errs on the large side (Efron and Stein)


def test_self_distance_by_leaving_out() -> None:
    rng = np.random.default_rng(3)
    sample = rng.normal(0, 1, (5, 2))
    table = squared_distances(sample, sample)
    mean, error = self_mean_and_error(table)
    off = ~np.eye(5, dtype=bool)
    assert mean == pytest.approx(table[off].mean())
    left_out = []
    for k in range(5):
        rest = [i for i in range(5) if i != k]
        sub = table[np.ix_(rest, rest)]
        left_out.append(sub[~np.eye(4, dtype=bool)].mean())
    assert error == pytest.approx(np.sqrt(4 / 5 * np.sum((np.array(left_out) - np.mean(left_out)) ** 2)))


def test_one_simulation_has_no_error() -> None:
    assert mean_and_error(np.array([[0.4]])) == (0.4, None)
    assert self_mean_and_error(np.array([[0.0, 0.2], [0.2, 0.0]])) == (0.2, None)
