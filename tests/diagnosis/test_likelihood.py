"""The likelihood by products against the same worked out on all measurements."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.inference.block import View
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.view_likelihood import view_log_likelihood

COUNT, NODES, SIZES = 50, 4, 7
MODEL = LikelihoodModel()


def directly(view: View, response: np.ndarray, scene: str) -> float:
    """Of one size, direction by direction: errors grown by the responses' mean square, of which a share counts; along a
    response, whose length is uncertain, all the more of them the longer that of one effect alone is."""
    known = np.stack([response, *view.taken])
    grown = 1.0 + MODEL.form_share**2 * float((known**2).sum()) / COUNT
    length, axes = np.linalg.svd(known / np.sqrt(grown), full_matrices=False)[1:]
    left = (view.measured - response) / np.sqrt(grown)
    along = (axes @ left) ** 2
    seen = length**2 / (length**2 + 1.0) if not view.taken else np.ones(len(known))
    counted = MODEL.dimension_share + (1.0 - MODEL.dimension_share) * seen
    granted = MODEL.template_share**2 * length**2 / (1.0 + MODEL.template_share**2 * length**2)
    square = MODEL.dimension_share * (float(left @ left) - along.sum()) + float(((counted - granted) * along).sum())
    spread = 0.5 * np.log1p(MODEL.template_share**2 * length**2).sum() + MODEL.dimension_share * (
        0.5 * COUNT * np.log(grown) + view.log_det
    )
    return float(MODEL.log_density(np.array(square), COUNT * MODEL.dimension_share, scene) - spread)


@pytest.mark.parametrize("before", [0, 1, 2])
@pytest.mark.parametrize("scene", ["hanging", "stretch"])
def test_products_say_what_all_measurements_say(before: int, scene: str) -> None:
    rng = np.random.default_rng(before)
    taken = tuple(8.0 * rng.standard_normal((before, COUNT)))
    rows, weights = 6.0 * rng.standard_normal((NODES, COUNT)), rng.standard_normal((SIZES, NODES))
    measured = weights[2] @ rows + rng.standard_normal(COUNT)
    view = View(measured, {}, {}, np.eye(COUNT), 1.5, taken=taken)
    found = view_log_likelihood(view, rows, weights, scene, MODEL)
    assert found == pytest.approx([directly(view, weight @ rows, scene) for weight in weights], rel=1e-6, abs=1e-6)
    assert int(found.argmax()) == 2


def test_nothing_taken_away_is_the_density_of_the_measurements() -> None:
    measured = np.random.default_rng(3).standard_normal(COUNT)
    view = View(measured, {}, {}, np.eye(COUNT), 0.0)
    found = view_log_likelihood(view, np.zeros((0, COUNT)), np.zeros((1, 0)), "stretch", MODEL)
    square, dimension = MODEL.dimension_share * float(measured @ measured), MODEL.dimension_share * COUNT
    assert found == pytest.approx(MODEL.log_density(np.array([square]), dimension, "stretch"))


def test_a_response_that_vanishes_is_as_probable_as_none() -> None:
    """What a block cannot show speaks neither for an effect nor against it."""
    rng = np.random.default_rng(5)
    rows = rng.standard_normal((1, COUNT))
    view = View(rng.standard_normal(COUNT) + 2.0 * rows[0], {}, {}, np.eye(COUNT), 0.0)
    still = view_log_likelihood(view, np.zeros((0, COUNT)), np.zeros((1, 0)), "stretch", MODEL)
    gone = view_log_likelihood(view, rows, np.array([[1e-4], [1e-2]]), "stretch", MODEL)
    np.testing.assert_allclose(gone, [still[0], still[0]], atol=0.05)
    assert abs(gone[0] - still[0]) < 1e-3
