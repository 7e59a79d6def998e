from __future__ import annotations

import math

import numpy as np
import pytest

from trainer.intervals import IntervalTable, conformal_factors, scene_key


def test_intervals_cover_new_materials_at_the_stated_rate() -> None:
    rng = np.random.default_rng(0)
    covered = []
    for _ in range(200):
        spread = np.exp(rng.normal(size=(40, 6)))
        residuals = spread * rng.standard_t(3, size=(40, 6))  # the spread's shape is right, its size is not
        factors = np.array(conformal_factors(residuals, spread, np.arange(40)))
        fresh = np.exp(rng.normal(size=(50, 6)))
        covered.append(np.abs(fresh * rng.standard_t(3, size=(50, 6))) <= fresh * factors)
    assert 0.89 < float(np.mean(covered)) < 0.93


def test_many_pictures_of_one_material_count_as_one() -> None:
    residuals = np.concatenate([np.full((1000, 6), 9.0), np.arange(1, 20)[:, None] * np.ones((19, 6))])
    materials = np.concatenate([np.zeros(1000, dtype=int), np.arange(1, 20)])
    alone = conformal_factors(np.arange(1, 21)[:, None] * np.ones((20, 6)), np.ones((20, 6)), np.arange(20))
    assert alone == (19.0,) * 6  # ceil(0.9 * 21) = 19th of 20
    assert conformal_factors(residuals, np.ones_like(residuals), materials) == (18.0,) * 6


def test_too_few_materials_promise_nothing() -> None:
    few = conformal_factors(np.ones((8, 6)), np.ones((8, 6)), np.arange(8))
    assert all(math.isinf(f) for f in few)
    assert all(math.isfinite(f) for f in conformal_factors(np.ones((9, 6)), np.ones((9, 6)), np.arange(9)))


def test_table_survives_json() -> None:
    table = IntervalTable({"hanging": (1.0, 2.0, 3.0, 4.0, 5.0, math.inf)}, {"hanging": 30})
    assert IntervalTable.from_json(table.to_json()) == table
    assert table.half_widths(("hanging",), np.full((1, 6), 2.0))[0, 1] == pytest.approx(4.0)


def test_scene_sets_have_one_name() -> None:
    assert scene_key(("stretch", "hanging")) == scene_key(("hanging", "stretch")) == "hanging+stretch"
