"""Every number of a blind check, against what was counted by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import pytest

from diagnosis.blind.answers import Answer
from diagnosis.blind.page import render_page
from diagnosis.blind.score import Score, Share, score
from tests.diagnosis.blind_answers import CURL, DRAFT, HEM, MANIFEST, TILT, answer, further

CREASE = {"name": "crease", "stage": "fabric", "magnitude": 1.0, "place": {"down": 1.0, "position": 0.331}}
SHIFT = {"name": "camera_translation", "stage": "camera", "magnitude": {"tx": 3.0, "ty": 0.0, "tz": 4.0}}
FAR_Z: dict[str, Any] = {
    "magnitude": {"tx": 3.0, "ty": 0.0, "tz": 7.0},
    "interval_90": {"tx": [2.0, 4.0], "ty": [-1.0, 1.0], "tz": [6.0, 8.0]},
}
"""Of its three numbers the last is not in its interval; off by 3 of 5."""


def line(down: float, magnitude: float, low: float, high: float) -> dict[str, Any]:
    """A crease as it was found."""
    return {
        "magnitude": magnitude,
        "interval_90": [low, high],
        "place": {"down": down, "position": 0.35},
    }


ANSWERS = [
    answer(
        "named", [{**DRAFT, "magnitude": 0.25}], "air_draft", 0.9, verified=further(0.6, 0.8, True, (0.1, 0.4, 0.2))
    ),
    # right, as a declared group counts as one; a size of another effect says nothing
    answer("named", [TILT], "air_draft", 0.7, closes=(0.6, 0.3), verified=further(1.0, 0.8, True, (0.3, 0.2, 0.4))),
    answer(
        "named",
        [CREASE],
        "crease",
        0.96,
        closes=(0.95, 0.2),
        verified=further(0.5, 0.5, False),
        **line(1, 1.4, 1.3, 1.5),
    ),
    answer(
        "named",
        [CREASE],
        "crease",
        0.5,
        closes=(0.9, 0.05),
        verified=further(0.88, 0.8, True, (0.2, 0.9, 0.3)),
        **line(0, 1.1, 0.9, 1.2),
    ),
    answer("named", [CREASE], "crease", 0.96, closes=(1.0, 0.4), **line(1, 1.05, 0.9, 1.2)),
    answer("named", [SHIFT], "camera_translation", 0.99, closes=None, verified=further(0.45, 0.5, None), **FAR_Z),
    # wrong: the first two of the right stage, the third of none
    answer(
        "named",
        [CURL],
        "crease",
        0.85,
        rest="edge_curl",
        closes=(0.2, 0.7),
        verified=further(0.3, 0.6, True, (9.0, 9.0, 9.0)),
        **line(1, 1.0, 0.9, 1.1),
    ),
    # the true effect closes too little to be a measure
    answer("named", [CURL], "hem_weight", 0.8, rest="edge_curl", closes=(0.1, 0.6), verified=further(0.05, 0.1, False)),
    answer("named", [HEM], "unknown", 0.3, verified=further(0.0, 0.05, None)),
    answer("none", [], "none", 0.7, detected=False),
    answer("none", [], "crease", 0.85),
    answer("none", [], "unknown", 0.5),
    answer("wrong_parameter", [], "hem_weight", 0.99),
    *(answer("wrong_parameter", [], "none", p) for p in (0.55, 0.92, 0.97)),
    *(answer("withheld", [HEM], "unknown", p) for p in (0.5, 0.7, 0.9)),
    answer("withheld", [HEM], "crease", 0.95, verified=further(0.1, 0.9, False, (9.0, 9.0, 9.0))),
    answer("withheld", [HEM], "crease", 0.8),  # not sure enough to mislead
    answer("two", [DRAFT, HEM], "panel_tilt", 0.9, also="hem_weight", verified=further(0.1, 0.9, False)),
    answer("two", [CREASE, HEM], "crease", 0.9, **line(0, 1.0, 0.9, 1.1)),
    answer("two", [DRAFT, HEM], "crease", 0.9),
]
COUNTED = {
    "top1": Share(6, 9),
    "top1_strict": Share(5, 9),
    "stage": Share(7, 9),
    "false_alarms": Share(2, 3),
    "none_named": Share(1, 3),
    "wrong_parameter_blamed": Share(1, 4),
    "withheld_unknown": Share(3, 5),
    "withheld_misnamed": Share(1, 5),
    "one_of_two": Share(2, 3),
    "both_of_two": Share(1, 3),
    "place_right": Share(2, 3),
    "magnitude_inside": Share(3, 5),
    "shrinkage_covered": Share(4, 6),
    "covered_below_one": Share(3, 5),
}
MEASURED = {
    "probability_of_truth": (0.9 + 0.7 + 0.96 + 0.5 + 0.96 + 0.99 + 0.15 + 0.2 + 0.0) / 9,
    "magnitude_error": 0.2,  # of 0.05, 0.1, 0.2, 0.4, 0.6
    "shrinkage": 0.9,  # of 0.6, 0.8, 0.9, 0.95, 1.0
    "control": 0.2,  # of 0.05, 0.1, 0.2, 0.3, 0.4
    "shrinkage_relative": (0.9 + 1.0) / 2,  # of 0.5, 0.75, 0.9, 1.0, 1.1, 1.25
}
CALIBRATED = [(0.0, 0.4, 1, 0.0), (0.4, 0.6, 3, 2 / 3), (0.6, 0.8, 2, 1.0), (0.8, 0.95, 5, 0.4), (0.95, 1.0, 5, 0.8)]
"""Of single effects, none and wrong parameters."""


def test_every_number_is_what_it_says() -> None:
    result = score(ANSWERS)
    assert {name: getattr(result, name) for name in COUNTED} == COUNTED
    assert {name: getattr(result, name) for name in MEASURED} == pytest.approx(MEASURED)
    assert result.parameter_error == pytest.approx((0.2, 0.4, 0.3))
    for row, expected in zip(result.calibration, CALIBRATED, strict=True):
        assert row == pytest.approx(expected)
    assert result.baselines == {
        "nearest_template": Share(3, 9),
        "least_residual": Share(1, 9),
        "most_flexible": Share(0, 9),
    }
    rest = {"parameter_error", "calibration", "baselines"}
    assert {*COUNTED, *MEASURED, *rest} == {field.name for field in fields(Score)}


def test_a_number_is_beside_its_name_on_the_page() -> None:
    page = render_page(MANIFEST, ANSWERS, score(ANSWERS))
    for row in (
        "| effect named right (declared groups count as one) | 0.67 (6 of 9) | at least 0.90 |",
        "| stage right | 0.78 (7 of 9) |  |",
        "| effect named although nothing is there | 0.33 (1 of 3) | at most 0.05 |",
        "| effect named although one parameter of one fabric is wrong | 0.25 (1 of 4) | at most 0.10 |",
        "| effect named right, groups not counted as one | 0.56 (5 of 9) |  |",
        "| share closed on further, sealed captures inside the stated 90 % interval | 0.67 (4 of 6) | 0.85 to 0.95 |",
        "| the same of shares below 1, above which none lies | 0.60 (3 of 5) |  |",
        "| the same of the most flexible wrong effect (control) | 0.20 | |",
        "| median error of the parameters as stated, refitted without, refitted with the effect (named right) | "
        "0.200, 0.400, 0.300 | |",
        "| 0.80 to 0.95 | 5 | 0.40 |",
    ):
        assert row in page.splitlines()


def test_a_classifier_is_counted_where_it_answered_every_case() -> None:
    def with_classifier(given: Sequence[Answer]) -> list[Answer]:
        names = {"classifier": "edge_curl"}
        return [replace(a, baselines={**a.baselines, "names": {**a.baselines["names"], **names}}) for a in given]

    assert score(with_classifier(ANSWERS)).baselines["classifier"] == Share(2, 9)
    assert "classifier" not in score([*with_classifier(ANSWERS[:7]), *ANSWERS[7:]]).baselines


def test_of_what_was_not_drawn_nothing_is_said() -> None:
    result = score([answer("none", [], "none", 0.7, detected=False)])
    drawn = {"false_alarms", "none_named"}
    assert {name for name in COUNTED if getattr(result, name).of} == drawn
    assert all(math.isnan(getattr(result, name)) for name in MEASURED)
    assert all(math.isnan(error) for error in result.parameter_error)
    assert str(result.top1) == "none drawn" and result.baselines == {}
    assert [count for _, _, count, _ in result.calibration] == [0, 0, 1, 0, 0]
