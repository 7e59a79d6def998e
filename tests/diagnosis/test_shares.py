"""Shares of a gap that go away, and how sure they are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from diagnosis.shrinkage.shares import OTHERWISE, fraction_of, interval_of, means, share_with_floors


@pytest.mark.parametrize(
    ("before", "after", "floor", "share"),
    [
        (4.0, 1.0, 0.5, 3.0 / 3.5),
        (4.0, 0.2, 0.5, 1.0),  # what is left is less than the floor
        (0.5, 1.0, 0.2, -0.5 / 0.3),
        (0.5, 1.0, 0.6, -1.0),  # nothing was above the floor
        (1.0, 1.0, 2.0, 0.0),
    ],
)
def test_the_share_is_that_of_the_gap_above_the_floor(before: float, after: float, floor: float, share: float) -> None:
    values = np.array([[before, after, floor]])
    assert fraction_of(np.concatenate([values, values]) ** 2) == pytest.approx(share)
    assert fraction_of(np.concatenate([values, values]), means) == pytest.approx(share)


def test_nothing_that_goes_away_is_no_minus() -> None:
    assert np.copysign(1.0, fraction_of(np.array([[1.0, 1.0, 2.0]]), means)) == 1.0


def test_one_block_says_nothing_of_others_and_of_alike_ones_others_leave_a_little_more_or_less() -> None:
    row = np.array([[16.0, 1.0, 0.25]])
    assert interval_of(row) == (-1.0, 1.0)
    worse = np.array([[1.0, 16.0, 0.25]])
    assert interval_of(worse)[0] == fraction_of(worse) < -1.0
    low, high = interval_of(np.repeat(worse, 4, axis=0))
    assert low < fraction_of(worse) < high  # of several blocks, too: what lies below is not cut off
    more, less = (np.array([[16.0, left**2, 0.25]]) for left in (1.0 + OTHERWISE, 1.0 / (1.0 + OTHERWISE)))
    assert interval_of(np.repeat(row, 4, axis=0)) == pytest.approx((fraction_of(more), fraction_of(less)))


def test_nothing_lies_above_one_so_an_interval_that_ends_there_misses_ten_in_a_hundred_below() -> None:
    rows = np.repeat(np.array([[4.0, 1.05, 1.0]]), 4, axis=0)
    low, high = interval_of(rows, means)
    assert high == 1.0
    tenth = (1.0 + OTHERWISE) ** (norm.ppf(0.9) / norm.ppf(0.95))
    assert low == pytest.approx((4.0 - 1.05 * tenth) / 3.0)
    twentieth = interval_of(np.repeat(np.array([[4.0, 1.2, 1.0]]), 4, axis=0), means)
    assert twentieth[1] < 1.0 and twentieth[0] == pytest.approx((4.0 - 1.2 * (1.0 + OTHERWISE)) / 3.0)


def test_a_share_lies_inside_its_interval_nine_times_in_ten() -> None:
    rng = np.random.default_rng(3)
    true = fraction_of(np.array([[4.0, 2.0, 1.0]]), means)
    inside, widths = 0, []
    for _ in range(300):
        rows = np.array([4.0, 2.0, 1.0]) * np.exp(0.2 * rng.standard_normal((4, 3)))
        low, high = interval_of(rows, means)
        inside += low <= true <= high
        widths.append(high - low)
    assert 0.8 < inside / 300 < 0.99
    assert float(np.median(widths)) < 0.8


def test_without_repeats_in_every_block_there_is_no_share() -> None:
    assert share_with_floors([(3.0, 1.0, 0.5), (3.0, 1.0, None)], means) == (None, None)
    assert share_with_floors([], means) == (None, None)
    fraction, interval = share_with_floors([(3.0, 1.0, 0.5), (3.0, 1.5, 0.5)], means)
    assert fraction == pytest.approx(1.75 / 2.5)
    assert interval is not None and interval[0] < 0.7 < interval[1]
