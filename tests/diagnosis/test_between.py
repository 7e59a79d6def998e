"""The leading effect is looked at where it was not simulated: beside the place that fits best, or at another width."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from diagnosis.afresh import between
from diagnosis.afresh.between import LOOKS, further_places, look_between, most_looks, most_trials
from diagnosis.afresh.fresh import Sized
from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect


def at(**place: float) -> dict[str, float]:
    return {SCALAR: 1.0, **place}


@pytest.mark.parametrize(
    ("position", "beside"), [(0.3, [0.25, 0.35]), (0.35, [0.3, 0.4]), (0.2, [0.25]), (0.5, [0.45, 0.55])]
)
def test_beside_a_crease_are_the_lines_half_a_tenth_away(position: float, beside: list[float]) -> None:
    crease = get_effect("crease")
    places = [crease.tried[number] for number in further_places(crease, at(down=0.0, position=position))]
    assert sorted(place["position"] for place in places) == beside
    assert {place["down"] for place in places} == {0.0}


def test_of_a_curl_the_middle_width_is_looked_at() -> None:
    curl = get_effect("edge_curl")
    for place in curl.tried:
        (number,) = further_places(curl, {SCALAR: 12.0, **place})
        assert curl.tried[number] == {"width_m": 0.035}


def test_the_forecast_counts_what_may_be_tried() -> None:
    """A crease is brought on at the fitted line and two beside it; a curl's other width is looked at without that."""
    assert (most_looks(("air_draft",)), most_trials(("air_draft",))) == (0, 0)
    assert (most_looks(("air_draft", "edge_curl")), most_trials(("air_draft", "edge_curl"))) == (LOOKS, 0)
    assert (most_looks(("crease", "edge_curl")), most_trials(("crease", "edge_curl"))) == (LOOKS, 3)


class Search:
    """Simulates nothing; says what it was asked for."""

    asked: ClassVar[list[list[Sized]]] = []

    @classmethod
    def after(cls, *_: Any) -> Search:
        return cls()

    def unseen(self, near: Sequence[Sized]) -> list[Sized]:
        return [sized for sized in near if sized[1].get("width_m") != "seen"]

    def simulated(self, looks: Mapping[str, Any], wanted: list[Sized]) -> Mapping[str, Any]:
        self.asked.append(wanted)
        return looks

    def rounds(self, looks: Mapping[str, Any]) -> Mapping[str, Any]:
        return {key: SimpleNamespace(result="again") for key in looks}


class Look(SimpleNamespace):
    def copy(self) -> Look:
        return self


def cause_of(first: str, named: tuple[str, ...], size: dict[str, float]) -> Any:
    places = tuple({SCALAR: 1.0 + n, **place} for n, place in enumerate(get_effect(first).tried))
    evidence = {first: SimpleNamespace(size=size, at_places=places), "none": SimpleNamespace()}
    return SimpleNamespace(evidence=evidence, probabilities={first: 0.9, "none": 0.1}, named=named)


def looked(monkeypatch: pytest.MonkeyPatch, causes: list[Any], squares: Sequence[Sequence[float]] = ()) -> bool:
    """Whether the looks that come back have learnt anything."""
    Search.asked = []
    monkeypatch.setattr(between, "Search", Search)
    monkeypatch.setattr(between, "squares", lambda *_: np.array(squares))
    found = iter(causes)
    looks: Any = {"f1": Look(result="first")}
    weigh: Any = None
    return look_between(looks, weigh, lambda results: next(found), "stretch")["f1"].result == "again"


CREASE = {SCALAR: 1.0, "down": 1.0, "position": 0.3}


def test_the_line_that_brings_most_fabrics_nearer_is_simulated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cause = cause_of("crease", ("crease",), CREASE)
    nearer = [[1.0, 1.0, 1.0], [0.95, 0.95, 0.95], [0.5, 0.5, 3.0]]  # fitted, at 0.25, at 0.35
    assert looked(monkeypatch, [cause, cause], nearer)
    (((name, size),),) = Search.asked
    number = get_effect("crease").number_of({"down": 1.0, "position": 0.35})
    assert (name, size) == ("crease", cause.evidence["crease"].at_places[number])


def test_no_line_is_simulated_that_brings_few_fabrics_nearer(monkeypatch: pytest.MonkeyPatch) -> None:
    cause = cause_of("crease", ("crease",), CREASE)
    assert not looked(monkeypatch, [cause], [[1.0, 1.0, 1.0], [0.95, 0.95, 0.95], [0.5, 1.1, 1.2]])
    assert Search.asked == []


def test_what_it_shows_counts_only_where_the_effect_is_named_then(monkeypatch: pytest.MonkeyPatch) -> None:
    first, then = cause_of("crease", ("crease",), CREASE), cause_of("crease", (), CREASE)
    assert not looked(monkeypatch, [first, then], [[1.0, 1.0], [0.5, 0.5], [0.4, 0.4]])
    assert len(Search.asked) == 1


def test_another_width_of_a_curl_is_simulated_whatever_its_distance(monkeypatch: pytest.MonkeyPatch) -> None:
    cause = cause_of("edge_curl", ("edge_curl",), {SCALAR: 20.0, "width_m": 0.025})
    assert looked(monkeypatch, [cause, cause])
    (((name, size),),) = Search.asked
    assert name == "edge_curl" and size["width_m"] == 0.035


@pytest.mark.parametrize("first", ["rest_curvature", "pin_spacing", "camera_rotation", "panel_friction", "depth_bias"])
def test_effects_without_places_between_are_left_alone(first: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not looked(monkeypatch, [cause_of(first, (first,), {SCALAR: 1.0})])
    assert Search.asked == []
