"""Pictures of the wrong corner pulled are told by their scores in the mirror."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from capture.capture_set import CaptureSet
from capture.normalise import NetworkInput
from capture.prepare import prepare_all
from simcore.scenes import Scene
from trainer.mirrored import BETTER_SHARE, fits_better_in_the_mirror, mirror_reason
from trainer.predict import Estimator


def flipped(one: NetworkInput) -> NetworkInput:
    return replace(one, height=one.height[:, ::-1].copy(), mask=one.mask[:, ::-1].copy())


def pulled(shared_dir: Path, case: str, count: int) -> list[NetworkInput]:
    """The first ``stretch`` pictures of an open set, poses as stated."""
    captures = CaptureSet.load(shared_dir / "cases" / case).captures
    return [p.network_input for p in prepare_all([c for c in captures if c.scene is Scene.STRETCH][:count])]


def test_a_score_well_below_its_own_fits_better() -> None:
    scores, mirrored = [1.0, 1.0, 0.5, math.inf], [0.99 * BETTER_SHARE, 1.01 * BETTER_SHARE, 0.9, math.inf]
    assert fits_better_in_the_mirror(scores, mirrored).tolist() == [True, False, False, False]


def test_the_pictures_are_named_by_number() -> None:
    assert mirror_reason(Scene.STRETCH, [False, False]) is None
    said = mirror_reason(Scene.STRETCH, [True, False, True])
    assert said is not None and said.startswith("picture 1, 3 of 3 of stretch fits better in the mirror: check that")


def test_a_flipped_picture_is_told_that_scores_within_the_border(shared_dir: Path) -> None:
    estimator = Estimator.load()
    taken = pulled(shared_dir, "open-1", 2)
    plain = estimator.estimate({"stretch": taken}, 0.2)
    assert plain.reasons == () and not plain.out_of_distribution
    found = estimator.estimate({"stretch": [taken[0], flipped(taken[1])]}, 0.2)
    assert [reason.split(":")[0] for reason in found.reasons] == ["picture 2 of 2 of stretch fits better in the mirror"]
    assert found.out_of_distribution and found.out_of_distribution_score < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("case", ["open-3", "open-5"])
def test_pictures_as_they_were_taken_do_not_fit_better_in_the_mirror(shared_dir: Path, case: str) -> None:
    """The two open sets whose scores in the mirror come nearest to their own."""
    shown = pulled(shared_dir, case, 8)
    found = Estimator.load().estimate({"stretch": shown}, 0.2)
    assert len(shown) == 8 and not any("mirror" in reason for reason in found.reasons)
