"""The likelihood by products against the same worked out on all measurements."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.block import View
from diagnosis.likelihood import LikelihoodModel, view_log_likelihood

COUNT, NODES, SIZES = 50, 4, 7
MODEL = LikelihoodModel()


def directly(view: View, response: np.ndarray, scene: str) -> float:
    """Of one size: errors grown by the responses' mean square, the responses' own lengths uncertain by a share."""
    known = np.stack([response, *view.taken])
    grown = 1.0 + MODEL.form_share**2 * float((known**2).sum()) / COUNT
    along = np.linalg.svd(known, full_matrices=False)[2]
    left = view.measured - response
    beside = left - along.T @ (along @ left)
    covariance = grown * np.eye(len(along)) + MODEL.template_share**2 * (along @ known.T) @ (along @ known.T).T
    inside = float((along @ left) @ np.linalg.solve(covariance, along @ left))
    square = MODEL.dimension_share * float(beside @ beside) / grown + inside
    spread = 0.5 * np.linalg.slogdet(covariance / grown)[1] + MODEL.dimension_share * (
        0.5 * COUNT * np.log(grown) + view.log_det
    )
    dimension = COUNT * MODEL.dimension_share
    return float(MODEL.log_density(np.array(square), dimension, scene) - spread)


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
