from __future__ import annotations

import numpy as np
import pytest
import torch

from trainer.calibrate import REFERENCE_PICTURES, _thinned
from trainer.dataset import PictureTable
from trainer.outliers import GaussianReference, OutlierModel, picture_statistics


def _correlated(rng: np.random.Generator, count: int) -> np.ndarray:
    mixing = np.random.default_rng(9).normal(size=(5, 40))
    return rng.normal(size=(count, 5)) @ mixing + 0.05 * rng.normal(size=(count, 40))


def test_new_pictures_of_the_same_kind_pass_and_others_do_not() -> None:
    rng = np.random.default_rng(0)
    statistics = rng.normal(size=(700, 9))
    model = OutlierModel.fit(_correlated(rng, 400), statistics[:400], _correlated(rng, 300), statistics[400:])
    fresh = model.scores(_correlated(rng, 500), rng.normal(size=(500, 9))).max(axis=1)
    assert (fresh > 1).mean() < 0.06
    off_the_plane = _correlated(rng, 100) + rng.normal(size=(100, 40))
    assert (model.scores(off_the_plane, rng.normal(size=(100, 9))).max(axis=1) > 1).all()
    far_along = 6 * _correlated(rng, 100)
    assert (model.scores(far_along, rng.normal(size=(100, 9))).max(axis=1) > 1).mean() > 0.8
    assert (model.scores(_correlated(rng, 100), 7 + rng.normal(size=(100, 9))).max(axis=1) > 1).all()


def test_stored_reference_scores_the_same() -> None:
    rng = np.random.default_rng(1)
    model = OutlierModel.fit(
        _correlated(rng, 60), rng.normal(size=(60, 9)), _correlated(rng, 20), rng.normal(size=(20, 9))
    ).stored()
    again = OutlierModel.from_tensors("a", model.to_tensors("a"))
    features, statistics = _correlated(rng, 5), rng.normal(size=(5, 9))
    assert np.array_equal(model.scores(features, statistics), again.scores(features, statistics))


def test_constant_features_do_not_break_it() -> None:
    distances = GaussianReference.fit(np.ones((20, 8))).distances(np.ones((3, 8)))
    assert np.isfinite(distances).all()


def test_statistics_say_what_they_say() -> None:
    height = torch.zeros(2, 1, 40, 40)
    height[0, 0, 10:30, 5:35] = 0.1
    area, rows, columns, mean, low, middle, high, _, border = picture_statistics(height)[0]
    assert abs(area - 600 / 1600) < 0.08 and abs(rows - 0.5) < 0.1 and abs(columns - 0.75) < 0.1
    assert abs(mean - 2.0) < 0.4 and abs(middle - high) < 1e-6 and low <= middle
    assert 0 < border < 0.3
    assert not picture_statistics(height)[1].any()


@pytest.mark.parametrize(("inclinations", "jitters", "materials"), [(11, 2, 1200), (11, 1, 2400), (1, 4, 900)])
def test_the_reference_shows_every_scene_and_inclination(inclinations: int, jitters: int, materials: int) -> None:
    """Rows of a store come by material, scene, repeat and inclination: a fixed stride would miss some."""
    rows = np.arange(materials * 2 * jitters * inclinations)
    table = PictureTable(
        row=rows,
        shard=rows // 704,
        material=rows // (2 * jitters * inclinations),
        scene=rows // (jitters * inclinations) % 2,
        parameters=np.ones((len(rows), 7)),
        inclination_deg=(rows % inclinations).astype(np.float64),
        jitter=rows // inclinations % jitters,
    )
    chosen = _thinned(table)
    assert len(chosen) <= REFERENCE_PICTURES and np.bincount(chosen.scene).tolist() == [REFERENCE_PICTURES // 2] * 2
    for scene in range(2):
        own = chosen.scene == scene
        assert len(np.unique(chosen.inclination_deg[own])) == inclinations
        assert len(np.unique(chosen.jitter[own])) == jitters
    assert np.array_equal(_thinned(table).row, chosen.row)
