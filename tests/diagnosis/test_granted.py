"""How large errors simulators are granted, as the captures have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.diagnose import conclude
from diagnosis.inference.cause import Cause
from diagnosis.inference.granted import NEAR_M, NEAR_SQUARE, likeliest, sizes_of_errors
from diagnosis.inference.noise import NoiseModel
from diagnosis.tasks.fabric_task import FabricResult
from tests.diagnosis.conftest import CANDIDATES, Diagnose, MakeSet


@pytest.fixture(scope="module")
def plain(make_set: MakeSet, explain: Diagnose) -> tuple[FabricResult, ...]:
    return explain(make_set()).results


def otherwise(results: Sequence[FabricResult], size_m: float) -> list[FabricResult]:
    """As if another simulator had made the captures: a smooth difference, the same in all repeats of a fabric."""
    rng = np.random.default_rng(5)
    changed = []
    for result in results:
        centre = result.captures[0].reference.centre
        distance = np.linalg.norm(centre[:, None] - centre[None], axis=2)
        lengths = (NoiseModel().length, NoiseModel().short_length)
        kernel = sum(0.5 * np.exp(-0.5 * (distance / length) ** 2) for length in lengths)
        factor = np.linalg.cholesky(kernel + 1e-9 * np.eye(len(kernel)))
        error = size_m * factor @ rng.standard_normal(len(kernel))
        captures = tuple(
            replace(c, measured=replace(c.measured, shape=c.measured.shape + error)) for c in result.captures
        )
        changed.append(replace(result, captures=captures))
    return changed


def test_a_simulation_that_is_near_is_granted_little(plain: tuple[FabricResult, ...]) -> None:
    found = conclude(plain, CANDIDATES).cause
    assert found.top == "none"
    assert found.errors.common_m == NEAR_M


def test_a_simulation_that_differs_is_granted_the_usual_errors(plain: tuple[FabricResult, ...]) -> None:
    found = conclude(otherwise(plain, 0.0004), CANDIDATES).cause
    assert found.errors.common_m == NoiseModel().common_m


def test_everything_after_goes_by_the_same_errors(plain: tuple[FabricResult, ...]) -> None:
    """Blocks that regions and shares are judged by are whitened by the errors that the answer was found with."""
    near, far = conclude(plain, CANDIDATES), conclude(otherwise(plain, 0.0004), CANDIDATES)
    assert all(block.calm_square == NEAR_SQUARE for block in near.blocks)
    assert all(block.calm_square == 1.0 for block in far.blocks)


def test_the_likelier_answer_is_taken() -> None:
    likelihood = {NEAR_M: -3.0, NoiseModel().common_m: -2.0}

    def weigh(errors: NoiseModel) -> Cause:
        return Cause({"none": 1.0}, {}, 0.0, likelihood=likelihood[errors.common_m])

    assert likeliest(weigh, NoiseModel()).errors == NoiseModel()
    likelihood[NEAR_M] = -1.0
    assert likeliest(weigh, NoiseModel()).errors.common_m == NEAR_M


def test_errors_smaller_than_any_are_as_they_are_given() -> None:
    given = NoiseModel(common_m=0.00001)
    assert sizes_of_errors(given) == (given,)
