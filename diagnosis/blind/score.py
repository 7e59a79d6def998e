"""Count what a blind check showed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from diagnosis.blind.answers import Answer
from diagnosis.blind.baselines import BASELINES
from diagnosis.blind.places import is_its_place
from diagnosis.effects import catalogue, get_effect
from diagnosis.groups import group_of

CONFIDENT = 0.8
LEAST_FRACTION = 0.1
"""A true effect that closes less of the gap says nothing about how much a found one should."""


def same(answer: str, truth: str) -> bool:
    """Right, declared groups counting as one."""
    return answer in group_of(truth)


@dataclass(frozen=True)
class Share:
    """A count out of a total."""

    hits: int
    of: int

    @property
    def value(self) -> float:
        """NaN of none."""
        return self.hits / self.of if self.of else float("nan")

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.hits} of {self.of})" if self.of else "none drawn"


@dataclass(frozen=True)
class Score:
    """What a blind check showed; see ``docs/blind-check.md`` for the words.

    ``calibration`` lists (stated probability's lower and upper bound, cases, share that was right).
    """

    top1: Share
    stage: Share
    probability_of_truth: float
    false_alarms: Share
    none_named: Share
    wrong_parameter_blamed: Share
    withheld_unknown: Share
    withheld_misnamed: Share
    one_of_two: Share
    both_of_two: Share
    place_right: Share
    magnitude_inside: Share
    magnitude_error: float
    shrinkage: float
    shrinkage_relative: float
    shrinkage_covered: Share
    covered_below_one: Share
    control: float
    parameter_error: tuple[float, float, float]
    top1_strict: Share
    calibration: tuple[tuple[float, float, int, float], ...]
    baselines: Mapping[str, Share]


def score(answers: Sequence[Answer]) -> Score:
    """Count."""
    by_kind = {kind: [a for a in answers if a.kind == kind] for kind in {a.kind for a in answers}}
    named, calm = by_kind.get("named", []), by_kind.get("none", [])
    wrong, two, withheld = (by_kind.get(k, []) for k in ("wrong_parameter", "two", "withheld"))
    right = [a for a in named if same(a.top, a.truth[0])]
    sizes = [_magnitude(a) for a in right if a.top == a.truth[0]]
    placed = [found for found in (_is_placed(a) for a in right if a.top == a.truth[0]) if found is not None]
    fractions = [a.report["shrinkage"]["fraction"] for a in right if a.report["shrinkage"]]
    controls = [a.report["shrinkage"]["control"]["fraction"] for a in right if a.report["shrinkage"]]
    checked = [a.report["verified"] for a in named if a.report.get("verified")]
    relative = [v["fraction"] / v["true_fraction"] for v in checked if v["true_fraction"] > LEAST_FRACTION]
    told = [v for v in checked if v["covered"] is not None]
    below = [v for v in told if v["fraction"] < 1.0]
    errors = [a.report["verified"]["parameter_error"] for a in right if a.report.get("verified")]
    known = np.array([e for e in errors if e is not None])
    single = [a for a in answers if a.kind in ("named", "none", "wrong_parameter")]
    return Score(
        top1=Share(len(right), len(named)),
        stage=Share(sum(_stage(a.top) == a.label["effects"][0]["stage"] for a in named), len(named)),
        probability_of_truth=float(np.mean([a.probability(a.truth[0]) for a in named])) if named else float("nan"),
        false_alarms=Share(sum(a.report["gap"]["detected"] for a in calm), len(calm)),
        none_named=Share(sum(bool(a.named) for a in calm), len(calm)),
        wrong_parameter_blamed=Share(sum(bool(a.named) for a in wrong), len(wrong)),
        withheld_unknown=Share(sum(a.top == "unknown" for a in withheld), len(withheld)),
        withheld_misnamed=Share(
            sum(bool(a.named) and a.certainty > CONFIDENT for a in withheld),
            len(withheld),
        ),
        one_of_two=Share(sum(any(same(a.top, t) for t in a.truth) for a in two), len(two)),
        both_of_two=Share(sum(all(any(same(n, t) for n in a.named) for t in a.truth) for a in two), len(two)),
        place_right=Share(sum(placed), len(placed)),
        magnitude_inside=Share(sum(inside for _, inside in sizes), len(sizes)),
        magnitude_error=float(np.median([error for error, _ in sizes])) if sizes else float("nan"),
        shrinkage=_median(fractions),
        shrinkage_relative=_median(relative),
        shrinkage_covered=Share(sum(v["covered"] for v in told), len(told)),
        covered_below_one=Share(sum(v["covered"] for v in below), len(below)),
        control=_median(controls),
        parameter_error=(_median(known[:, 0]), _median(known[:, 1]), _median(known[:, 2]))
        if len(known)
        else (math.nan, math.nan, math.nan),
        top1_strict=Share(sum(a.top == a.truth[0] for a in named), len(named)),
        calibration=_calibration(single),
        baselines={
            name: Share(sum(same(a.baselines["names"][name], a.truth[0]) for a in named), len(named))
            for name in (*BASELINES, "classifier")
            if named and all(name in a.baselines["names"] for a in named)
        },
    )


def _median(values: Sequence[float] | NDArray[np.float64]) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _stage(name: str) -> str:
    return catalogue()[name].stage.value if name in catalogue() else name


def _magnitude(answer: Answer) -> tuple[float, bool]:
    """Relative error of the named effect's size, and whether all of it lies in the stated interval."""
    truth = answer.label["effects"][0]["magnitude"]
    found = next(e for e in answer.report["cause"]["effects"] if e["name"] == answer.truth[0])
    if isinstance(truth, dict):
        a = np.array([truth[k] for k in truth])
        b = np.array([found["magnitude"][k] for k in truth])
        inside = all(found["interval_90"][k][0] <= truth[k] <= found["interval_90"][k][1] for k in truth)
        return float(np.linalg.norm(a - b) / np.linalg.norm(a)), inside
    low, high = found["interval_90"]
    return abs(found["magnitude"] - truth) / abs(truth), low <= truth <= high


def _is_placed(answer: Answer) -> bool | None:
    """Whether the named effect was found beside where it is; None where that says nothing of it."""
    name = answer.truth[0]
    found = next(e for e in answer.report["cause"]["effects"] if e["name"] == name).get("place")
    if not found or not get_effect(name).between:
        return None
    return is_its_place(name, answer.label["effects"][0]["place"], found)


def _calibration(answers: Sequence[Answer]) -> tuple[tuple[float, float, int, float], ...]:
    """Stated probability of the answer against how often it was right, over none and single effects."""
    edges = (0.0, 0.4, 0.6, 0.8, 0.95, 1.0001)
    rows = []
    for low, high in pairwise(edges):
        own = [a for a in answers if low <= a.certainty < high]
        right = [same(a.top, a.truth[0]) if a.truth else a.top == "none" for a in own]
        rows.append((low, min(high, 1.0), len(own), float(np.mean(right)) if own else float("nan")))
    return tuple(rows)
