"""Orderings known beforehand, and the comparison of image distances on them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from metric.comparison import score_backend
from metric.depth_rmse import DepthRmse
from metric.figures import spread
from metric.matrix import DistanceMatrix
from metric.orderings import SWEPT, default_sweeps, monotone_share
from metric.render import DrapeRender
from metric.scaling import classical_scaling, excess_distance
from simcore.errors import InputError
from simcore.prior import FabricPrior
from simcore.scenes import Scene

MakeRender = Callable[..., DrapeRender]


def test_sweeps_stay_among_real_fabrics_and_change_one_property() -> None:
    prior = FabricPrior.default()
    for sweep in default_sweeps(5):
        values = np.stack([f.as_array() for f in sweep.fabrics])
        assert prior.accepts(values).all()
        changing = [n for n, column in zip(sweep.fabrics[0].as_dict(), values.T, strict=True) if np.ptp(column) > 0]
        assert tuple(changing) == SWEPT[sweep.name]
        assert (np.diff(values[:, np.ptp(values, axis=0) > 0], axis=0) > 0).all()
    with pytest.raises(InputError, match="at least 3 steps, got 2") as caught:
        default_sweeps(2)
    assert caught.value.code == "sweep_too_short"


def test_monotone_share_of_a_line_of_chance_and_of_the_reverse() -> None:
    line = np.abs(np.arange(6.0)[:, None] - np.arange(6.0))
    assert monotone_share(line) == 1.0
    assert monotone_share(-line) == 0.0
    rng = np.random.default_rng(0)
    shares = [monotone_share(np.where(np.eye(6) > 0, 0, rng.random((6, 6)))) for _ in range(200)]
    assert np.mean(shares) == pytest.approx(0.5, abs=0.03)
    assert np.isnan(monotone_share(line[:2, :2]))


def test_scores_of_a_distance(make_render: MakeRender) -> None:
    def sets(amplitude: float, seed: int) -> dict[Scene, list[DrapeRender]]:
        phases = np.random.default_rng(seed).uniform(0, 0.2, (2, 3))
        return {s: [make_render(2.0, p, amplitude) for p in phases[k]] for k, s in enumerate(Scene)}

    amplitudes = np.linspace(0.01, 0.06, 5)
    fabrics = [sets(a, k) for k, a in enumerate(amplitudes)]
    done: list[int] = []
    score = score_backend(DepthRmse(), fabrics, {"amplitude": fabrics}, on_done=lambda: done.append(1))
    assert score.self_nearest == 1.0
    assert score.monotone == {"amplitude": 1.0}
    assert set(score.by_simulations) == set(score.monotone_by_simulations["amplitude"]) == {1, 2, 3}
    assert set(score.self_nearest_by_scene) == set(Scene)
    assert score.renders == 2 * 5 * 3 * 2
    assert len(done) == 2 * 5 * 2
    assert score.matrix.shape == (5, 5)


def test_scaling_finds_points_again() -> None:
    points = np.random.default_rng(0).normal(0, 1, (7, 2)) * [3.0, 1.0]
    squared = np.sum((points[:, None] - points[None]) ** 2, axis=2)
    found = classical_scaling(squared)
    again = np.sum((found.points[:, None] - found.points[None]) ** 2, axis=2)
    assert np.allclose(again, squared)
    assert found.explained == pytest.approx(1.0)
    assert np.ptp(found.points[:, 0]) > np.ptp(found.points[:, 1])


def test_excess_distance_takes_the_scatter_of_repeats_away() -> None:
    distance = np.array([[0.2, 0.9, 0.25], [0.9, 0.4, 0.7], [0.25, 0.7, 0.3]])
    excess = excess_distance(DistanceMatrix(distance, distance))
    assert excess[0, 1] == pytest.approx(0.9 - 0.3)
    assert excess[0, 2] == 0.0
    assert not np.diag(excess).any()


def test_pictures_of_an_embedding_do_not_overlap() -> None:
    points = np.random.default_rng(0).normal(0, 0.1, (12, 2))
    points[5] = points[6]
    places = spread(points, (0.2, 0.1))
    apart = np.abs(places[:, None] - places[None])
    clear = (apart[:, :, 0] > 0.195) | (apart[:, :, 1] > 0.0975) | np.eye(12, dtype=bool)
    assert clear.all()
    alone = np.array([[0.0, 0.0], [5.0, 5.0]])
    assert np.allclose(spread(alone, (0.2, 0.1)), alone, atol=1e-5)
