"""Responses bent through fresh simulations, and what is common to all repeats but in no catalogue."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.block import Block, View
from diagnosis.effects import get_effect
from diagnosis.fresh import bend
from diagnosis.likelihood import LikelihoodModel, view_log_likelihood
from diagnosis.reference import CELLS
from diagnosis.sizes import node_weights, nodes
from diagnosis.smooth_modes import smooth_modes
from diagnosis.unknown import unknown_shape


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("air_draft", {"magnitude": 0.31}),
        ("crease", {"magnitude": -0.7, "down": 0.0, "position": 0.5}),
        ("stretch_stiffening", {"magnitude": 0.05}),
    ],
)
def test_bent_responses_pass_through_what_was_simulated(name: str, size: dict[str, float]) -> None:
    effect = get_effect(name)
    rng = np.random.default_rng(1)
    rows, wanted = rng.standard_normal((len(nodes(effect)), 5)), rng.standard_normal(5)
    bent = bend(effect, rows, [(size, wanted)])
    np.testing.assert_allclose(node_weights(effect, size) @ bent, wanted, atol=1e-9)
    untouched = node_weights(effect, size) == 0
    np.testing.assert_array_equal(bent[untouched], rows[untouched])


def block_of(measured: np.ndarray) -> Block:
    """Two repeats whose errors are independent, 0.5 mm in each cell."""
    count = CELLS * CELLS
    factor = 0.0005 * np.eye(2 * count)
    view = View(measured / 0.0005, {}, {}, factor, float(2 * count * np.log(0.0005)))
    cell, owner = np.tile(np.arange(count), 2), np.repeat([0, 1], count)
    still = np.zeros((4, 2 * count))
    return Block("f1", "stretch", ("a", "b"), view, view, cell, owner, np.zeros((7, 2 * count)), still, still)


def test_a_smooth_change_that_repeats_share_is_better_explained_by_an_unknown_shape_than_by_errors() -> None:
    rng = np.random.default_rng(2)
    model = LikelihoodModel()
    shape = smooth_modes()[: CELLS * CELLS] @ rng.standard_normal(smooth_modes().shape[1]) * 0.003
    noise = 0.0005 * rng.standard_normal(2 * CELLS * CELLS)

    def gain(measured: np.ndarray) -> float:
        view = block_of(measured).stated
        still = np.zeros((1, len(measured)))
        nothing = view_log_likelihood(view, view.measured[None], still, "stretch", model)[0]
        return float(unknown_shape(block_of(measured), model).max() - nothing)

    assert gain(np.tile(shape, 2) + noise) > 10.0
    assert gain(noise) < 0.0
