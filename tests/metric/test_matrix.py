"""Matrices of drape distances, the paper's minimum requirement, and sketches of features."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from metric.backends import SquaredEuclideanBackend
from metric.drape_distance import drape_distance
from metric.matrix import PairTables, pair_tables, share_by_repeats
from metric.psnr import Psnr
from metric.render import DrapeRender
from metric.sketch import Sketched, count_sketch
from simcore.errors import InputError
from simcore.scenes import Scene

MakeRender = Callable[..., DrapeRender]


def render_sets(make: MakeRender, folds: float, count: int) -> dict[Scene, list[DrapeRender]]:
    return {scene: [make(folds, 0.2 * i + 0.1 * k) for i in range(count)] for k, scene in enumerate(Scene)}


def tables_of_points(centres: np.ndarray, spread: float, repeats: int, seed: int = 0) -> PairTables:
    rng = np.random.default_rng(seed)
    found = {}
    for scene in Scene:
        points = (centres[:, None, :] + spread * rng.normal(0, 1, (len(centres), repeats, centres.shape[1]))).reshape(
            len(centres) * repeats, -1
        )
        squared = np.sum((points[:, None] - points[None]) ** 2, axis=2)
        found[scene] = squared.reshape(len(centres), repeats, len(centres), repeats)
    return PairTables(found)


def test_matrix_equals_pairwise_distances(make_render: MakeRender) -> None:
    sets = [render_sets(make_render, folds, 3) for folds in (1.5, 2.5, 4.0)]
    matrix = pair_tables(sets, Psnr()).matrix()
    for a in range(3):
        for b in range(3):
            found = drape_distance(sets[a], None if a == b else sets[b], Psnr())
            assert matrix.distance[a, b] == pytest.approx(found.distance, abs=1e-3)
            assert matrix.standard_error[a, b] == pytest.approx(found.standard_error, abs=1e-3)


def test_minimum_requirement() -> None:
    far = tables_of_points(np.eye(5) * 10, 0.1, 4)
    assert far.matrix().self_nearest_share == 1.0
    same = tables_of_points(np.zeros((5, 3)), 1.0, 4)
    assert 0.2 < same.matrix().self_nearest_share < 0.8


def test_share_grows_with_the_number_of_repeats() -> None:
    assert np.allclose(
        tables_of_points(np.eye(3), 0.5, 4).distances(np.tile(np.arange(4), (3, 1))),
        tables_of_points(np.eye(3), 0.5, 4).matrix().distance,
    )
    tables = tables_of_points(np.random.default_rng(0).normal(0, 1, (8, 5)), 1.0, 10)
    shares = share_by_repeats(tables, (1, 3, 10), trials=20, rng=np.random.default_rng(1))
    assert shares[1][0] < shares[3][0] < shares[10][0] <= 1.0
    assert shares[10][1] == 0.0  # only one choice of ten out of ten
    assert shares[10][0] == tables.matrix().self_nearest_share


def test_one_scene_alone() -> None:
    tables = tables_of_points(np.eye(3), 0.1, 3)
    one = tables.scenes_only([Scene.STRETCH])
    both = tables.scenes_only([Scene.HANGING]).matrix().distance + one.matrix().distance
    assert np.allclose(tables.matrix().distance, both / 2)


def test_uneven_sets_are_refused(make_render: MakeRender) -> None:
    two = render_sets(make_render, 2.0, 2)
    for other in (render_sets(make_render, 3.0, 3), {Scene.HANGING: two[Scene.HANGING]}):
        with pytest.raises(InputError, match="equally many renders in the same scenes") as caught:
            pair_tables([two, other], Psnr())
        assert caught.value.code == "renders_uneven"
    with pytest.raises(InputError, match="two fabrics") as caught:
        pair_tables([two], Psnr())
    assert caught.value.code == "fabrics_too_few"
    with pytest.raises(InputError, match="two simulations") as caught:
        pair_tables([render_sets(make_render, f, 1) for f in (2.0, 3.0)], Psnr()).matrix()
    assert caught.value.code == "renders_too_few"


def test_sketches_keep_squared_distances() -> None:
    rng = np.random.default_rng(0)
    vectors = [rng.normal(0, 1, 100_000).astype(np.float32) * rng.random(100_000) ** 3 for _ in range(12)]
    sketches = [count_sketch(v, 4096) for v in vectors]
    ratios = [
        np.sum((sketches[i] - sketches[j]) ** 2) / np.sum((vectors[i] - vectors[j]) ** 2)
        for i in range(12)
        for j in range(i)
    ]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.02)
    assert np.std(ratios) < 1.5 * np.sqrt(2 / 4096)
    assert np.array_equal(sketches[0], count_sketch(vectors[0], 4096))


def test_a_sketched_back_end_is_a_back_end_of_its_own(make_render: MakeRender, pixels: SquaredEuclideanBackend) -> None:
    backend = Sketched(pixels, 2048)
    assert backend.fingerprint != pixels.fingerprint
    sets = [render_sets(make_render, folds, 2) for folds in (1.5, 4.0)]
    exact = drape_distance(sets[0], sets[1], pixels).distance
    assert drape_distance(sets[0], sets[1], backend).distance == pytest.approx(exact, rel=0.1)
