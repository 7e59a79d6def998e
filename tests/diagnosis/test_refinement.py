"""Which effects are looked at again."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from diagnosis.afresh import refinement
from diagnosis.afresh.fresh import FreshLook
from diagnosis.afresh.refinement import Search, look_again
from diagnosis.effect import SCALAR
from diagnosis.inference.cause import Cause
from diagnosis.inference.evidence import Evidence
from diagnosis.workers import ALONE
from tests.diagnosis.trial_parts import TrialWorkers, trial_look


def cause_of(nats: dict[str, float]) -> Any:
    """Evidence for some effects, all at usual sizes."""
    sizes = {
        "sensor_smoothing": {"magnitude": 1.2, "after_noise": 1.0},
        "rest_curvature": {"magnitude": 8.0, "weft": 1.0, "warp": 0.0},
    }

    def entry(name: str, value: float) -> Any:
        size = sizes.get(name, {"magnitude": 5.0})
        return SimpleNamespace(name=name, log_evidence=value, usual_evidence=value, usual=size, size=size)

    evidence = {name: entry(name, value) for name, value in {**nats, "none": 0.0}.items()}
    evidence["none"].usual = {}
    return SimpleNamespace(evidence=evidence, probabilities={name: e.log_evidence for name, e in evidence.items()})


def wanted(alone: dict[str, float], beside: dict[str, float]) -> list[list[str]]:
    workers = TrialWorkers()

    def weigh(results: list[Any], first: Any) -> Any:
        return cause_of(alone if first is None else beside)

    look_again({"f1": trial_look()}, weigh, "stretch", workers)  # type: ignore[arg-type]
    return workers.names


def test_what_one_fabric_alone_has_simulated_is_simulated_in_all() -> None:
    sizes = {"hem_weight": [{"magnitude": 5.0}, {"magnitude": 9.0}]}
    looks: Any = {"f1": SimpleNamespace(sizes=sizes), "f2": SimpleNamespace(sizes={"hem_weight": [{"magnitude": 5.0}]})}
    search = Search.after(looks, lambda *_: None, "stretch", ALONE)  # type: ignore[arg-type, return-value]
    assert search.unseen([("hem_weight", {"magnitude": 5.0}), ("hem_weight", {"magnitude": 9.0})]) == [
        ("hem_weight", {"magnitude": 9.0})
    ]


def test_beside_a_leader_on_the_sensor_three_effects_on_the_cloth_are_looked_at() -> None:
    beside = {"panel_adhesion": 2.7, "rest_curvature": 2.6, "air_draft": 1.3, "panel_tilt": 0.1}
    rounds = wanted({"sensor_smoothing": 50.0, "panel_tilt": -3.0}, beside)
    assert rounds == [["panel_adhesion", "rest_curvature", "air_draft"]]


def test_beside_effects_on_the_cloth_that_are_looked_at_anyway_two_more_are() -> None:
    beside = {"pin_drop": 2.7, "hem_weight": 2.6, "corner_pull": 1.3}
    rounds = wanted({"panel_tilt": 50.0, "pin_spacing": 47.0}, beside)
    assert rounds == [["panel_tilt", "pin_spacing", "pin_drop", "hem_weight"]]


@pytest.mark.parametrize(
    ("alone", "beside", "rounds"),
    [
        # later, what is near: the two likeliest, one of which was simulated
        (
            ({"panel_tilt": 50.0}, {"panel_tilt": 50.0, "pin_spacing": 49.0, "hem_weight": 48.0}),
            ({}, {}),
            [["panel_tilt"], ["pin_spacing"]],
        ),
        # later, beside what is not on the cloth: two as well
        (
            ({"sensor_smoothing": 50.0},) * 2,
            ({"hem_weight": 1.0}, {"hem_weight": 1.0, "pin_spacing": 0.9, "corner_pull": 0.8, "off_grain": 0.7}),
            [["hem_weight"], ["pin_spacing"]],
        ),
    ],
)
def test_in_the_second_round_fewer_are_looked_at(alone: Any, beside: Any, rounds: list[list[str]]) -> None:
    workers = TrialWorkers()

    def weigh(results: list[Any], first: Any) -> Any:
        number = min(len(workers.wanted), 1)
        return cause_of(alone[number] if first is None else beside[number])

    look_again({"f1": trial_look()}, weigh, "stretch", workers)  # type: ignore[arg-type]
    assert workers.names == rounds


def on_trial(alone: dict[str, float], named: list[str]) -> tuple[list[list[str]], bool]:
    """What was simulated, effects being named once something was; whether what that shows was kept."""
    first, other = trial_look("as it was"), trial_look("simulated")
    workers = TrialWorkers(lambda: other, untaught=first)

    def weigh(results: list[str], found: Any) -> Any:
        cause = cause_of(alone)
        cause.named = () if results == ["as it was"] else tuple(named)
        return cause

    kept = look_again({"f1": first}, weigh, "stretch", workers)  # type: ignore[arg-type]
    return workers.names, kept["f1"] is other


FAR = {"corner_pull": -7.7, "off_grain": -5.8, "pin_spacing": -6.3, "stretch_stiffening": -7.9}


@pytest.mark.parametrize(("named", "kept"), [(["off_grain"], True), (["stretch_stiffening"], False), ([], False)])
def test_where_nothing_leads_effects_from_further_behind_count_where_one_of_them_is_named(
    named: list[str], kept: bool
) -> None:
    assert on_trial(FAR, named) == ([["off_grain", "pin_spacing", "corner_pull"]], kept)


def test_what_was_simulated_already_is_not_tried_again() -> None:
    nearer = FAR | {"off_grain": -4.0}
    workers = TrialWorkers()

    def weigh(results: list[Any], found: Any) -> Any:
        cause = cause_of(nearer)
        cause.named = ()
        return cause

    look_again({"f1": trial_look()}, weigh, "stretch", workers)  # type: ignore[arg-type]
    assert workers.names == [["off_grain"], ["pin_spacing", "corner_pull"]]


def test_after_a_trial_that_named_an_effect_what_comes_near_it_is_looked_at() -> None:
    workers = TrialWorkers(lambda: trial_look("simulated"))

    def weigh(results: list[str], found: Any) -> Any:
        cause = cause_of({"off_grain": 9.0, "hem_weight": 5.0} if results == ["simulated"] else FAR)
        cause.named = ("off_grain",) if results == ["simulated"] else ()
        return cause

    look_again({"f1": trial_look("as it was")}, weigh, "stretch", workers)  # type: ignore[arg-type]
    assert workers.names == [["off_grain", "pin_spacing", "corner_pull"], ["hem_weight"]]


def test_what_is_too_far_behind_is_not_tried() -> None:
    assert on_trial({"corner_pull": -8.1}, ["corner_pull"]) == ([], False)


def test_where_an_effect_leads_and_beside_it_others_are_not_looked_at_from_so_far() -> None:
    rounds = wanted({"panel_tilt": 50.0, "pin_spacing": 44.0}, {"hem_weight": -6.0, "off_grain": -4.9})
    assert rounds == [["panel_tilt", "off_grain"]]


def test_a_weaker_effect_beside_a_strong_one_is_looked_at_too(monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[str] = []

    def freshen(look: Any, wanted: Sequence[tuple[str, Any]], scene: str) -> Any:
        looked.extend(name for name, _ in wanted)
        return look.result

    def weigh(results: Sequence[Any], beside: Any) -> Cause:
        strong, weak = (40.0, 1.0) if beside is None else (0.0, 1.0)
        evidence = {
            name: Evidence(name, value, value, {}, size, size, value, {})
            for name, value, size in (
                ("none", 0.0, {}),
                ("sensor_smoothing", strong, {SCALAR: 1.5, "after_noise": 1.0}),
                ("off_grain", weak, {SCALAR: 5.0}),
            )
        }
        top = "sensor_smoothing" if beside is None else "none"
        return Cause({name: float(name == top) for name in evidence}, evidence, strong)

    monkeypatch.setattr(refinement, "freshen", freshen)
    nothing: Any = None
    refinement.look_again({"f1": FreshLook(nothing, nothing)}, weigh, "stretch")
    assert looked == ["off_grain"]


def test_what_is_looked_at_again_is_of_a_size_inside_its_range() -> None:
    """The best size may lie below it, where a response of other folds vanishes and nothing is learnt."""
    evidence = {
        "none": Evidence("none", 0.0, 0.0, {}, {}, {}, 0.0, {}),
        "off_grain": Evidence("off_grain", 1.0, 1.0, {}, {SCALAR: 2.0}, {SCALAR: 5.0}, -1.0, {}),
        "hem_weight": Evidence("hem_weight", 2.0, 2.0, {}, {SCALAR: 4.0}, {SCALAR: 9.0}, -20.0, {}),
    }
    found = refinement.candidates(Cause({"none": 1.0, "off_grain": 0.0, "hem_weight": 0.0}, evidence, 0.0))
    assert found == [("off_grain", {SCALAR: 5.0})]
