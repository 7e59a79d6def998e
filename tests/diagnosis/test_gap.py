"""Whether there is a gap, and the floor of repeats beside it, on made-up blocks."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.gap.detection import WEIGHTS, detect
from diagnosis.gap.floor import repeat_squares
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.scatter import scattered_nats
from diagnosis.report import Gap
from tests.diagnosis.where_blocks import BULGE, make_blocks, make_pixels


def found(blocks_added: Any = 0.0, numbers_added: Any = 0.0, factor: float = 0.0, seed: int = 3) -> Gap:
    rng = np.random.default_rng(seed)
    cause: Any = SimpleNamespace(factor=factor)
    return detect(make_blocks(rng, blocks_added), make_pixels(rng, numbers_added), cause, LikelihoodModel())


def test_nothing_added_raises_no_alarm() -> None:
    calm = [found(seed=seed) for seed in range(5)]
    assert not any(gap.detected for gap in calm)
    assert all(gap.p_value == 1.0 or gap.p_value == min(parts(gap)) for gap in calm)


def parts(gap: Gap) -> list[float]:
    """Each test's p-value by its share of the alarms."""
    return [gap.p_factor / WEIGHTS["factor"], gap.p_shape / WEIGHTS["shape"], gap.p_pixels / WEIGHTS["pixels"]]


@pytest.mark.parametrize(
    ("added", "test"),
    [
        ({"blocks_added": 0.02 * BULGE}, "p_shape"),
        ({"numbers_added": 10.0}, "p_pixels"),
        ({"factor": 8.0}, "p_factor"),
    ],
)
def test_each_of_three_tests_raises_the_alarm_by_itself(added: dict[str, Any], test: str) -> None:
    gap = found(**added)
    others = {"p_shape", "p_pixels", "p_factor"} - {test}
    assert gap.detected and gap.p_value == pytest.approx(min(parts(gap)))
    assert getattr(gap, test) < 0.005 and all(getattr(gap, other) > 0.05 for other in others)


def test_the_floor_is_the_variance_between_repeats() -> None:
    """Two captures that differ by d in every cell: variance d²/2, with one degree of freedom."""
    (block, *_) = make_blocks(np.random.default_rng(0))
    values = np.where(block.owner == 0, 0.001, 0.004)
    assert repeat_squares(block, values) == pytest.approx(0.003**2 / 2.0)
    chosen = block.cell < 5
    assert repeat_squares(block, np.where(chosen, values, 7.0 * block.owner), chosen) == pytest.approx(0.003**2 / 2.0)


def test_captures_of_two_set_ups_do_not_repeat_each_other() -> None:
    (block, *_) = make_blocks(np.random.default_rng(0))
    values = np.where(block.owner == 0, 0.001, 0.004)
    apart = replace(block, setups=(0, 1))
    assert block.repeated and not apart.repeated
    assert repeat_squares(apart, values) is None and scattered_nats(apart) == 0.0


def test_the_floor_of_two_set_ups_is_that_of_repeats_within_each() -> None:
    """Two differ by 2 mm, three others by as much around another mean: variances 2 and 4 with 1 and 2 freedoms."""
    (block, *_) = make_blocks(np.random.default_rng(0), scatter_m=0.0)
    cells = int(block.cell.max()) + 1
    both = replace(
        block,
        captures=tuple("abcde"),
        setups=(0, 1, 0, 1, 1),
        owner=np.repeat(np.arange(5), cells),
        cell=np.tile(np.arange(cells), 5),
    )
    values = np.array([0.0, 0.010, 0.002, 0.012, 0.014])[both.owner]
    assert repeat_squares(both, values) == pytest.approx((1 * 2e-6 + 2 * 4e-6) / 3)
