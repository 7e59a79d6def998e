"""The human study's statistics, checked with simulated observers whose embedding is known."""

from __future__ import annotations

import warnings
from collections import Counter

import numpy as np
import pytest
from scipy.spatial import procrustes
from scipy.stats import spearmanr

from metric.agreement import agreement, metric_agreement, rank_correlations
from metric.observers import observer_stream, simulate_answers
from metric.triplets import Answer, Triplet, draw_triplets, shared_triplets
from metric.tste import _loss, answer_array, embed
from simcore.errors import InputError


def known_points(seed: int = 0, count: int = 10) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 1, (count, 2))


def distances(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[:, None] - points[None], axis=2)


def simulate_observers(truth: np.ndarray, observers: int, *, seed: int = 0, noise: float = 0.3) -> list[Answer]:
    """Answers to 20 questions by each of several observers of one set of distances [n, n]; 5 are put to all."""
    fabrics, answers = len(truth), []
    common = shared_triplets(fabrics, np.random.default_rng((seed, 0)), 5)
    for observer in range(observers):
        rng = observer_stream(seed, observer)
        questions = draw_triplets(fabrics, rng, count=20, shared=common)
        chosen = simulate_answers(questions, truth, rng, noise=noise)
        answers += [
            Answer(f"simulated-{observer}", *one, simulated=True) for one in zip(questions, chosen, strict=True)
        ]
    return answers


@pytest.mark.parametrize(("fabrics", "count"), [(10, 20), (5, 12), (7, 40), (3, 3)])
def test_triplets_are_balanced(fabrics: int, count: int) -> None:
    if count < 2 * fabrics:
        with pytest.raises(InputError, match="reference"):
            draw_triplets(fabrics, np.random.default_rng(0), count=count)
        return
    shared = shared_triplets(fabrics, np.random.default_rng(9), 4)
    triplets = draw_triplets(fabrics, np.random.default_rng(1), count=count, shared=shared)
    assert len(triplets) == count == len({t.question for t in triplets})
    references = Counter(t.reference for t in triplets)
    assert min(references.values()) >= 2
    assert len(references) == fabrics
    assert max(references.values()) - min(references.values()) <= 1
    assert {t.question for t in shared} <= {t.question for t in triplets}
    assert all(len({t.reference, t.left, t.right}) == 3 for t in triplets)
    shown = Counter(f for t in triplets for f in (t.left, t.right))
    assert max(shown.values()) - min(shown.values()) <= 4


def test_triplets_depend_on_the_participant_alone() -> None:
    first = draw_triplets(10, np.random.default_rng(5))
    assert first == draw_triplets(10, np.random.default_rng(5))
    assert first != draw_triplets(10, np.random.default_rng(6))


def test_impossible_studies_are_refused() -> None:
    rng = np.random.default_rng(0)
    for fabrics, count, code in ((2, 20, "fabrics_too_few"), (4, 13, "triplets_many"), (11, 20, "triplets_few")):
        with pytest.raises(InputError) as caught:
            draw_triplets(fabrics, rng, count=count)
        assert caught.value.code == code
    with pytest.raises(InputError, match="neither of the two") as caught:
        Answer("p", Triplet(0, 1, 2), 0)
    assert caught.value.code == "answer_not_offered"


def test_gradient_of_the_embedding_loss() -> None:
    rng = np.random.default_rng(0)
    triplets = answer_array(simulate_observers(distances(known_points()), 2, seed=1))
    point = rng.normal(0, 1, 20)
    value, gradient = _loss(point, triplets, 10, 1.0, 0.1)
    assert value > 0
    for index in (0, 7, 19):
        step = np.zeros(20)
        step[index] = 1e-6
        ahead, behind = (_loss(point + s, triplets, 10, 1.0, 0.1)[0] for s in (step, -step))
        assert gradient[index] == pytest.approx((ahead - behind) / 2e-6, rel=1e-4, abs=1e-8)


def test_the_embedding_is_recovered_from_simulated_observers() -> None:
    truth = known_points(3)
    answers = simulate_observers(distances(truth), 40, seed=2, noise=0.15)
    assert all(a.simulated for a in answers)
    found = embed(answer_array(answers), 10)
    assert np.mean(rank_correlations(found.distances, distances(truth))) > 0.9
    *_, disparity = procrustes(truth, found.points)
    assert disparity < 0.15  # answers fix the order of distances, not their ratios
    assert found.log_likelihood > np.log(0.5)


@pytest.mark.parametrize(("seed", "log_likelihood"), [(0, -0.258096), (1, -0.286623), (2, -0.294394)])
def test_as_probable_as_the_embedding_of_cblearn(seed: int, log_likelihood: float) -> None:
    """Best of eight runs of cblearn 0.4.0's TSTE on the same answers."""
    truth = np.random.default_rng(3).normal(0, 1, (10, 2))
    answers = simulate_observers(distances(truth), 20, seed=seed, noise=0.2)
    assert embed(answer_array(answers), 10, penalty=0.0).log_likelihood == pytest.approx(log_likelihood, abs=2e-3)


def test_chance_observers_give_chance_correlation() -> None:
    truth = distances(known_points(4))
    means = []
    for seed in range(12):
        answers = simulate_observers(truth, 15, seed=seed, noise=np.inf)
        found = embed(answer_array(answers), 10, restarts=3, seed=seed)
        means.append(np.nanmean(rank_correlations(found.distances, truth)))
    assert abs(np.mean(means)) < 0.15
    assert np.mean(np.abs(means)) < 0.3


def test_agreement_between_participants() -> None:
    triplet, mirrored, other = Triplet(0, 1, 2), Triplet(0, 2, 1), Triplet(1, 0, 2)
    answers = [
        Answer("a", triplet, 1),
        Answer("b", mirrored, 1),
        Answer("c", triplet, 2),
        Answer("a", other, 0),
    ]
    found = agreement(answers)
    assert found.share == pytest.approx(1 / 3)
    assert (found.questions, found.pairs) == (1, 3)
    assert agreement(answers[3:]).share is None


def test_agreement_of_perfect_and_of_coin_tossing_observers() -> None:
    truth = distances(known_points(5))
    assert agreement(simulate_observers(truth, 10, noise=0.0)).share == 1.0
    tossed = agreement(simulate_observers(truth, 60, noise=np.inf)).share
    assert tossed == pytest.approx(0.5, abs=0.05)


def test_metric_agreement_tells_the_true_metric_from_noise() -> None:
    truth = distances(known_points(6))
    noise = distances(known_points(7))
    answers = simulate_observers(truth, 25, seed=3, noise=0.2)
    found = metric_agreement({"truth": truth, "noise": noise}, answers, 10, bootstrap=25)
    assert found["truth"].mean > 0.85
    assert found["truth"].answers_predicted > 0.85
    interval = found["truth"].interval_95
    assert interval is not None
    assert interval[0] < interval[1] <= 1.0
    assert interval[0] > 0.6
    assert found["noise"].mean < 0.6
    assert found["noise"].interval_95 is not None
    assert found["noise"].interval_95[1] < interval[0] + 0.1


def test_of_one_participant_there_is_no_interval_and_of_one_distance_no_correlation() -> None:
    answers = simulate_observers(distances(known_points(6)), 1, seed=3, noise=0.2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = metric_agreement({"flat": np.ones((10, 10)) - np.eye(10)}, answers, 10, bootstrap=25)
    assert found["flat"].interval_95 is None
    assert np.isnan(found["flat"].mean)


def test_a_fabric_that_no_answer_names_ranks_nowhere() -> None:
    truth = distances(known_points())
    answers = [a for a in simulate_observers(truth, 20, seed=3, noise=0.1) if 9 not in _named(a)]
    found = metric_agreement({"true": truth}, answers, 10, bootstrap=5)["true"]
    assert np.isnan(found.per_fabric[9]) and np.isfinite(found.per_fabric[:9]).all()
    assert found.mean > 0.8 and found.interval_95 is not None
    one = metric_agreement({"true": truth}, answers[:1], 10, bootstrap=0)["true"]
    assert np.isfinite(one.per_fabric).sum() == 3
    few = sorted(_named(answers[0]))
    assert np.isfinite(one.per_fabric[few]).all()


def _named(answer: Answer) -> set[int]:
    return {answer.triplet.reference, answer.triplet.left, answer.triplet.right}


def test_the_interval_holds_what_studies_like_it_find() -> None:
    truth = distances(known_points(4))
    metric = distances(known_points(4) + np.random.default_rng(1).normal(0, 0.5, (10, 2)))
    found = [
        metric_agreement({"m": metric}, simulate_observers(truth, 8, seed=s, noise=0.3), 10, bootstrap=20)["m"]
        for s in range(8)
    ]
    middle = np.mean([one.mean for one in found])
    inside = [one.interval_95 is not None and one.interval_95[0] <= middle <= one.interval_95[1] for one in found]
    assert sum(inside) >= 6
    assert all(one.interval_95 is not None and one.interval_95[0] < one.mean < one.interval_95[1] for one in found)


def test_rank_correlation_is_spearmans() -> None:
    first, second = distances(known_points(8)), distances(known_points(9))
    others = np.arange(10) != 4
    expected = spearmanr(first[4, others], second[4, others]).statistic
    assert rank_correlations(first, second)[4] == pytest.approx(expected)
    for one, other in ((first, second[:5, :5]), (first[:2, :2], second[:2, :2]), (first[0], second[0])):
        with pytest.raises(InputError, match="same 3 or more fabrics") as caught:
            rank_correlations(one, other)
        assert caught.value.code == "matrices_differ"


def test_no_answers_no_embedding() -> None:
    with pytest.raises(InputError, match="none were given") as caught:
        embed(answer_array([]), 10)
    assert caught.value.code == "answers_missing"
    for named in (-1, 12):
        with pytest.raises(InputError, match="not in the study") as caught:
            embed(np.array([[0, 1, named]]), 10)
        assert caught.value.code == "answer_fabric_unknown"


def test_a_fabric_whose_distances_are_not_known_ranks_nowhere() -> None:
    """As if the study had been without it, but for the embedding, which holds all answers."""
    truth = distances(known_points())
    answers = simulate_observers(truth, 20, seed=3, noise=0.1)
    lost = truth.copy()
    lost[4], lost[:, 4] = np.nan, np.nan
    np.fill_diagonal(lost, np.nan)  # one simulation of each leaves no distance from itself either
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = metric_agreement({"lost": lost, "none": np.full_like(truth, np.nan)}, answers, 10, bootstrap=5)
    per_fabric = found["lost"].per_fabric
    assert np.isnan(per_fabric[4]) and np.isfinite(np.delete(per_fabric, 4)).all()
    assert found["lost"].mean > 0.8 and found["lost"].interval_95 is not None
    rest = [a for a in answers if 4 not in _named(a)]
    predicted = metric_agreement({"true": truth}, rest, 10, bootstrap=0)["true"].answers_predicted
    assert found["lost"].answers_predicted == predicted > 0.8
    assert np.isnan(found["none"].mean) and np.isnan(found["none"].answers_predicted)
    assert found["none"].interval_95 is None
