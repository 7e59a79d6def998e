"""A pair's probability is shared by its two effects."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.inference.cause import Cause, shared
from diagnosis.inference.evidence import Evidence
from diagnosis.inference.pairs import Pair, share_of

NOTHING = Evidence("none", 0.0, 0.0, {}, {}, {}, 0.0, {})
ALONE = {"none": 0.0, "unknown": 0.0, "depth_scale": 0.0, "depth_bias": 0.0, "quantisation": 0.0}
PAIRS = [
    Pair("depth_scale", "quantisation", {"depth_scale": {}, "quantisation": {}}, NOTHING),
    Pair("depth_bias", "quantisation", {"depth_bias": {}, "quantisation": {}}, NOTHING),
]


def test_in_halves_where_that_leaves_an_effect_of_the_pair_first() -> None:
    found = shared(ALONE | {"unknown": 0.1}, PAIRS[:1], [0.9])
    assert found["depth_scale"] == pytest.approx(0.45, abs=0.001) and found["quantisation"] == pytest.approx(
        0.45, abs=0.001
    )
    assert found["depth_scale"] > found["quantisation"]


def test_two_effects_that_are_more_probable_than_anything_by_one_are_named() -> None:
    """Depths out of scale in coarse steps: 0.38 for something unknown, 0.62 for two effects, in two ways."""
    alone = ALONE | {"unknown": 0.38}
    found = shared(alone, PAIRS, [0.39, 0.23])
    assert sum(found.values()) == pytest.approx(1.0) and min(found.values()) >= 0.0
    cause = Cause(found, {}, 1.0, PAIRS[0], 0.62, alone)
    assert cause.named == ("quantisation", "depth_scale")


def test_two_effects_less_probable_than_the_rest_are_shared_in_halves() -> None:
    found = shared(ALONE | {"unknown": 0.55}, PAIRS, [0.25, 0.2])
    assert found["quantisation"] == pytest.approx(0.225, abs=0.001) and max(found, key=lambda n: found[n]) == "unknown"


def test_no_pair_changes_nothing() -> None:
    assert shared(ALONE | {"none": 1.0}, [], []) == ALONE | {"none": 1.0}


def test_of_several_pairs_the_named_one_has_its_own_share() -> None:
    other = Pair("depth_scale", "crease", {"depth_scale": {}, "crease": {}}, NOTHING)
    assert share_of(PAIRS[0], [*PAIRS, other], np.log([0.2, 0.1, 0.5]).tolist()) == pytest.approx(0.3 / 0.8)
    assert share_of(other, [*PAIRS, other], [-900.0, -900.0, -900.0]) == pytest.approx(1.0 / 3.0)
    cause = Cause(ALONE, {}, 1.0, PAIRS[0], 0.8, ALONE, pair_share=0.5)
    assert cause.both_probability == pytest.approx(0.4)
    rounded = Cause(ALONE, {}, 1.0, PAIRS[0], 1.0000000000000002, ALONE)
    assert rounded.both_probability == 1.0
