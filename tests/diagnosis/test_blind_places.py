"""Where an effect was found, against where it truly is."""

from __future__ import annotations

import pytest

from diagnosis.blind.places import at_a_tried_place, is_its_place
from diagnosis.effect import SCALAR


@pytest.mark.parametrize(
    ("name", "place", "tried"),
    [
        ("crease", {"down": 1.0, "position": 0.331}, {"down": 1.0, "position": 0.35}),
        ("crease", {"down": 0.0, "position": 0.85}, {"down": 0.0, "position": 0.8}),
        ("edge_curl", {"width_m": 0.0271}, {"width_m": 0.025}),
        ("hem_weight", {}, {}),
    ],
)
def test_a_place_is_told_by_the_nearest_one_that_is_tried(
    name: str, place: dict[str, float], tried: dict[str, float]
) -> None:
    assert at_a_tried_place(name, {SCALAR: 0.7, **place}) == {SCALAR: 0.7, **tried}


@pytest.mark.parametrize(
    ("position", "down", "right"),
    [(0.35, 1.0, True), (0.3, 1.0, True), (0.4, 1.0, False), (0.35, 0.0, False), (0.3, 0.0, False)],
)
def test_a_crease_was_found_less_than_half_a_tenth_away(position: float, down: float, right: bool) -> None:
    truth = {SCALAR: 1.0, "down": 1.0, "position": 0.331}
    assert is_its_place("crease", truth, {"down": down, "position": position}) is right


def test_a_curl_was_found_in_a_strip_about_as_wide() -> None:
    truth = {SCALAR: 12.0, "width_m": 0.0327}
    found = [is_its_place("edge_curl", truth, {"width_m": width}) for width in (0.025, 0.03, 0.035, 0.04, 0.045)]
    assert found == [False, True, True, False, False]


def test_what_lies_beyond_all_tried_places_is_found_at_the_last_one() -> None:
    assert is_its_place("crease", {SCALAR: 1.0, "down": 1.0, "position": 0.85}, {"down": 1.0, "position": 0.8})
