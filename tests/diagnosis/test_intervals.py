"""Intervals of an effect's size."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.inference.intervals import all_inside, size_interval


def test_an_interval_holds_the_size_that_has_all_the_mass() -> None:
    sizes, mass = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.0, 0.02, 0.97, 0.01])
    low, high = size_interval(sizes, mass, 3.0)
    assert 2.0 < low < 3.0 < high < 4.0


def test_an_interval_of_many_points_is_that_of_the_distribution() -> None:
    sizes = np.linspace(-4.0, 4.0, 401)
    mass = np.exp(-0.5 * sizes**2)
    shuffled = np.random.default_rng(0).permutation(401)
    low, high = size_interval(sizes[shuffled], (mass / mass.sum())[shuffled], 0.0)
    assert (low, high) == pytest.approx((-1.645, 1.645), abs=0.01)


def test_sizes_that_come_at_several_places_count_once_each() -> None:
    sizes = np.tile([1.0, 2.0, 3.0], 2)
    low, high = size_interval(sizes, np.array([0.05, 0.4, 0.05, 0.05, 0.4, 0.05]), 2.0)
    assert low < 2.0 < high and low == pytest.approx(4.0 - high)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_error_that_all_captures_share_widens_an_interval_by_a_share_of_the_size(way: float) -> None:
    sizes, mass = way * np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 0.0])
    narrow = size_interval(sizes, mass, way * 2.0)
    wide = size_interval(sizes, mass, way * 2.0, 0.2)
    assert wide[0] < narrow[0] <= way * 2.0 <= narrow[1] < wide[1]
    assert max(abs(end) for end in wide) >= 2.0 * np.exp(1.645 * 0.2)
    assert min(abs(end) for end in wide) <= 2.0 * np.exp(-1.645 * 0.2)


def test_a_side_that_reaches_zero_is_left_as_it_is() -> None:
    sizes, mass = np.array([-1.0, 0.0, 1.0, 2.0]), np.array([0.3, 0.2, 0.3, 0.2])
    assert size_interval(sizes, mass, 1.0, 0.2)[0] == size_interval(sizes, mass, 1.0)[0] < 0.0


def test_intervals_of_several_numbers_hold_all_of_them_together() -> None:
    assert all_inside(1) == pytest.approx(1.645, abs=1e-3)
    drawn = np.abs(np.random.default_rng(2).standard_normal((100_000, 3)))
    assert np.mean((drawn < all_inside(3)).all(axis=1)) == pytest.approx(0.9, abs=0.005)
