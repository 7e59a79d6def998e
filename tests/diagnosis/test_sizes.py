"""Sizes that are simulated, and interpolation between them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from diagnosis.effect import Stage
from diagnosis.effects import catalogue, get_effect
from diagnosis.simulation.sizes import (
    FITTED_SHARE,
    PIXEL_NODES,
    fading,
    grid,
    interpolation,
    log_prior,
    node_values,
    nodes,
    response_forms,
)

SCALARS = sorted(n for n, e in catalogue().items() if not e.vector and not e.random_repeats)


@pytest.mark.parametrize("name", SCALARS)
def test_interpolation_returns_the_nodes_themselves(name: str) -> None:
    effect = get_effect(name)
    values = np.array(node_values(effect))
    np.testing.assert_allclose(interpolation(effect, values), np.eye(len(values)), atol=1e-12)


def test_a_linear_response_is_interpolated_and_continued_exactly() -> None:
    effect = get_effect("air_draft")
    response = 2.0 * np.array(node_values(effect))
    sizes = np.array([-0.6, -0.3, -0.01, 0.02, 0.4, 0.65])
    np.testing.assert_allclose(interpolation(effect, sizes) @ response, 2.0 * sizes, atol=1e-12)


def test_an_effect_that_vanishes_as_it_grows_goes_with_the_inverse_of_its_square() -> None:
    effect = get_effect("stretch_stiffening")
    values = np.array(node_values(effect))
    sizes = np.array([0.5 * values.min(), 0.6 * values.max(), 1.3 * values.max(), 10.0 * values.max()])
    np.testing.assert_allclose(interpolation(effect, sizes) @ values**-2.0, sizes**-2.0, rtol=1e-12)


@pytest.mark.parametrize("name", SCALARS)
def test_prior_sums_to_one_and_prefers_the_stated_range(name: str) -> None:
    effect = get_effect(name)
    sizes = grid(effect)
    weights = np.exp(log_prior(effect, sizes))
    component = next(iter(effect.components.values()))
    inside = (np.abs(sizes) >= component.low) & (np.abs(sizes) <= component.high)
    assert weights.sum() == pytest.approx(1.0)
    assert weights[inside].min() >= weights[~inside].max() - 1e-12


def test_sizes_outside_their_range_fade_as_fitted_sizes_err() -> None:
    component = next(iter(get_effect("rest_curvature").components.values()))
    one, two = np.exp(FITTED_SHARE), np.exp(2 * FITTED_SHARE)
    sizes = np.array([component.low, component.low / one, component.low / two, component.high, component.high * one])
    np.testing.assert_allclose(fading(component, sizes), [0.0, -0.5, -2.0, 0.0, -0.5], atol=1e-12)


def test_places_multiply_the_nodes() -> None:
    effect = get_effect("rest_curvature")
    assert len(nodes(effect)) == len(effect.places) * len(node_values(effect))


@pytest.mark.parametrize("name", SCALARS)
def test_the_forms_of_a_response_in_proportion_to_its_size_are_all_the_same(name: str) -> None:
    effect = get_effect(name)
    sizes, values = grid(effect), np.array(node_values(effect))
    response = values if effect.vanishes_at_zero else values**-2.0
    expected = sizes if effect.vanishes_at_zero else sizes**-2.0
    found = response_forms(effect, sizes)
    for form in found[1:]:
        np.testing.assert_allclose(form @ response, expected, rtol=1e-9)
    assert len(found) == (3 if values.min() < 0 else 2)


def test_a_large_size_in_other_folds_leaves_the_forms_of_small_ones() -> None:
    """Of a draft only the smallest one forward, or backward, is trusted; nothing of the largest comes in."""
    effect = get_effect("air_draft")
    values = np.array(node_values(effect))
    odd = np.where(np.abs(values) > 0.3, np.nan, 2.0 * values)
    _, forward, backward = response_forms(effect, np.array([0.5]))
    for form, own in ((forward, 0.25), (backward, -0.25)):
        used = form[0] != 0.0
        assert values[used].tolist() == [own]
        assert form[0][used] @ odd[used] == pytest.approx(1.0)


def test_effects_on_pixels_are_rendered_at_many_sizes_over_their_whole_range() -> None:
    """A blur of 0.75 px between nodes of 0.6 and 1.25 was read as 0.94: its statistics are far from linear there."""
    for name in ("sensor_smoothing", "quantisation", "edge_flying_pixels", "dropout", "range_noise"):
        effect = get_effect(name)
        component, values = effect.components["magnitude"], node_values(effect)
        assert effect.stage is Stage.SENSOR and len(values) == PIXEL_NODES
        assert values[0] < component.low and values[-1] == pytest.approx(component.high)
        assert max(b / a for a, b in pairwise(values)) < 1.35
