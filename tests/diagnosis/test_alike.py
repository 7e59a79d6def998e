"""What presses the cloth to the panel is tried in every way, wherever one of them leads."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.afresh import alike
from diagnosis.afresh.alike import (
    ALIKE_SIZES,
    look_alike,
    most_looks,
    pressing_otherwise,
    pressing_sizes,
    shows_another,
)
from diagnosis.effects import catalogue, get_effect
from tests.diagnosis.trial_parts import TrialWorkers, trial_look

PRESSING = [name for name in catalogue() if get_effect(name).presses]


def cause_of(leader: str, size: float = 1.0, named: tuple[str, ...] = (), without: tuple[str, ...] = ()) -> Any:
    """One effect leads, with a size that presses the cloth where it is 1."""
    nats = {"air_draft": -2.0, "panel_tilt": -1.0, "panel_adhesion": -3.0, "crease": -4.0, "none": -5.0} | {leader: 4.0}

    def entry(name: str) -> Any:
        presses = 0 if name == "none" else get_effect(name).presses
        own = {"magnitude": size * (presses or 1)}
        return SimpleNamespace(name=name, usual_evidence=-99.0, usual={}, size=own, log_evidence=nats[name])

    evidence = {name: entry(name) for name in nats if name not in without}
    return SimpleNamespace(named=named, evidence=evidence, probabilities=nats)


@pytest.mark.parametrize(
    ("leader", "others"),
    [
        ("air_draft", ["panel_adhesion"]),
        ("panel_tilt", ["panel_adhesion"]),
        ("panel_adhesion", ["panel_tilt"]),
        ("crease", []),
        ("none", []),
    ],
)
def test_others_press_the_cloth_and_are_no_twins_of_each_other(leader: str, others: list[str]) -> None:
    assert [effect.name for effect in pressing_otherwise(cause_of(leader))] == others


def test_what_lifts_the_cloth_is_like_no_adhesion() -> None:
    assert pressing_otherwise(cause_of("air_draft", -1.0)) == []


def test_one_that_is_left_out_of_the_catalogue_is_not_tried() -> None:
    assert pressing_otherwise(cause_of("air_draft", without=("panel_adhesion",))) == []


def test_the_forecast_counts_all_that_may_be_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """A user's own effect that presses the cloth, too; of twins one leads or is tried."""
    own = SimpleNamespace(name="static_charge", presses=1, twin=None)
    monkeypatch.setattr(alike, "get_effect", lambda name: own if name == own.name else get_effect(name))
    twins = ("air_draft", "panel_tilt", "crease")
    assert most_looks(twins) == 0
    assert most_looks((*twins, "panel_adhesion")) > ALIKE_SIZES
    assert most_looks((*twins, "panel_adhesion", own.name)) == most_looks((*twins, "panel_adhesion")) + ALIKE_SIZES


@pytest.mark.parametrize("name", PRESSING)
def test_they_are_simulated_at_sizes_that_press(name: str) -> None:
    sizes = pressing_sizes(get_effect(name))
    own = next(iter(get_effect(name).components.values()))
    middle = (own.low * own.high) ** 0.5
    np.testing.assert_allclose(sizes, [get_effect(name).presses * size for size in (middle, own.high)])
    assert len(sizes) == ALIKE_SIZES


def test_the_catalogue_says_what_presses_the_cloth() -> None:
    assert sorted(PRESSING) == ["air_draft", "panel_adhesion", "panel_tilt"]


def a_trial(leader: str, then: tuple[str, ...], known: tuple[float, ...] = ()) -> tuple[list[Any], bool]:
    """What was simulated where one leads and others are named then; whether that was kept."""
    sizes = {"panel_adhesion": [{"magnitude": size} for size in known]}
    first, other = trial_look("before", sizes), trial_look("after")
    workers = TrialWorkers(lambda: other, untaught=first)

    def name(results: list[str]) -> Any:
        if results == ["before"]:
            return cause_of(leader)
        return SimpleNamespace(named=then, probabilities=dict.fromkeys(then, 1.0))

    def weigh(results: list[str], found: Any) -> Any:
        return cause_of("none")

    kept = look_alike({"f1": first}, weigh, name, "stretch", workers)  # type: ignore[arg-type]
    simulated = [(name, round(size["magnitude"], 2)) for wanted in workers.wanted for name, size in wanted]
    return simulated, kept["f1"] is other


def test_a_trial_counts_where_it_lets_one_of_them_be_named() -> None:
    assert a_trial("panel_tilt", ("panel_adhesion",)) == ([("panel_adhesion", 1.87), ("panel_adhesion", 5.0)], True)
    assert a_trial("panel_tilt", ("panel_tilt",))[1] is False
    assert a_trial("crease", ("panel_adhesion",)) == ([], False)


@pytest.mark.parametrize(
    ("named", "adhesion", "shown"),
    [
        (("panel_adhesion",), 0.44, False),  # as measured: the tilt 0.39 and its twin 0.14
        (("panel_adhesion",), 0.60, True),
        (("panel_adhesion", "air_draft"), 0.44, True),  # together
        (("panel_tilt",), 0.20, False),
        ((), 0.20, False),
    ],
)
def test_another_is_likelier_than_what_led_and_its_twin_together(
    named: tuple[str, ...], adhesion: float, shown: bool
) -> None:
    probabilities = {"panel_adhesion": adhesion, "panel_tilt": 0.39, "air_draft": 0.14}
    found: Any = SimpleNamespace(named=named, probabilities=probabilities)
    assert shows_another(found, {"panel_adhesion"}, {"panel_tilt", "air_draft"}) is shown


def test_sizes_that_were_simulated_are_not_again() -> None:
    assert a_trial("air_draft", (), known=(1.8, 2.5))[0] == [("panel_adhesion", 5.0)]
    assert a_trial("air_draft", (), known=(1.8, 5.1)) == ([], False)
