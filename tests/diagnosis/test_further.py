"""Before something unknown is the answer, more of the catalogue is simulated on trial."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.afresh import further
from diagnosis.afresh.further import FURTHER, look_further
from tests.diagnosis.trial_parts import TrialWorkers, trial_look

CLOTH = ("air_draft", "crease", "edge_curl", "hem_weight", "off_grain", "panel_adhesion", "panel_tilt", "pin_drop")
"""From the likeliest to the least likely."""
SIZE = {"magnitude": 5.0}
MOVED = {"tx": 0.003, "ty": 0.0, "tz": 0.0}


def cause_of(top: str, leader: str | None = None, named: tuple[str, ...] = (), left: float | None = None) -> Any:
    """Something unknown ahead of what leads among the effects, or another answer."""
    nats = {name: -5.0 - n for n, name in enumerate(CLOTH)} | {"none": 0.0, "unknown": 9.0}
    places = {"crease": {"down": 1.0, "position": 0.5}, "edge_curl": {"width_m": 0.025}}
    sizes = {name: SIZE | places.get(name, {}) for name in CLOTH} | {"none": {}, "unknown": {}}
    if leader is not None:
        nats[leader], sizes[leader] = 4.0, sizes.get(leader, MOVED if leader == "camera_translation" else SIZE)

    def entry(name: str) -> Any:
        return SimpleNamespace(
            name=name, usual_evidence=nats[name], usual=sizes[name], size=sizes[name], log_evidence=0
        )

    return SimpleNamespace(
        top=top,
        named=named,
        left=left,
        evidence={name: entry(name) for name in nats},
        probabilities=nats | {"unknown": 99.0},
    )


def a_trial(
    top: str, leader: str | None, then: tuple[str, ...], first_named: tuple[str, ...] = (), left: float | None = None
) -> tuple[list[list[str]], list[Any], Any, bool]:
    """What was simulated, through which cameras and beside what it was chosen; whether the trial was kept."""
    beside = []
    first, other = (trial_look(name, {"air_draft": [SIZE]}) for name in ("before", "after"))
    workers = TrialWorkers(lambda: other, untaught=first)

    def weigh(results: list[str], found: Any) -> Any:
        if results == ["before"]:
            beside.append(found)
        return cause_of("none") if results == ["after"] else cause_of("unknown", leader)

    def name(results: list[str]) -> Any:
        return cause_of(top, leader, first_named, left) if results == ["before"] else cause_of("", None, then)

    kept = look_further({"f1": first}, weigh, name, "stretch", workers)  # type: ignore[arg-type]
    return workers.names, workers.through, beside, kept["f1"] is other


def test_where_something_unknown_is_the_answer_the_likeliest_are_tried_that_were_not_simulated() -> None:
    simulated, through, beside, kept = a_trial("unknown", None, ("panel_tilt",))
    assert simulated[0] == list(CLOTH[1 : 1 + FURTHER]) and kept  # the draft was simulated at this size
    assert through[0] == () and beside[0] is None


@pytest.mark.parametrize("then", [(), ("depth_bias",), ("air_draft",)])
def test_a_trial_that_lets_none_of_these_be_named_changes_nothing(then: tuple[str, ...]) -> None:
    assert not a_trial("unknown", None, then)[3]


@pytest.mark.parametrize("top", ["none", "panel_tilt"])
def test_another_answer_needs_no_trial(top: str) -> None:
    assert a_trial(top, None, ("panel_tilt",)) == ([], [], [], False)


@pytest.mark.parametrize(
    ("named", "left", "tried"),
    [
        ("camera_translation", 1.5, True),
        ("sensor_smoothing", 1.5, True),
        ("camera_translation", 1.2, False),
        ("camera_translation", None, False),  # too few fabrics
    ],
)
def test_where_a_camera_or_sensor_alone_leaves_much_others_are_tried(
    named: str, left: float | None, tried: bool
) -> None:
    simulated, _, beside, kept = a_trial(named, named, (named, "hem_weight"), (named,), left)
    assert bool(simulated) is kept is tried
    assert not tried or beside[0][0] == named


@pytest.mark.parametrize(("left", "near", "tried"), [(1.3, True, True), (1.3, False, False), (1.2, True, False)])
def test_where_one_on_the_cloth_leaves_much_those_that_come_as_near_are_tried(
    monkeypatch: pytest.MonkeyPatch, left: float, near: bool, tried: bool
) -> None:
    """A draft was named where the cloth stuck to the panel: that had never been simulated at its size."""

    def squares(looks: Any, trials: list[Any], scene: str, workers: Any) -> Any:
        assert [name for name, _ in trials[0]] == ["panel_tilt"]
        close = {"panel_tilt": [1.0, 1.0]} | ({"hem_weight": [2.8, 2.9]} if near else {})
        return np.array([close.get(trial[0][0], [2.0, 9.0]) for trial in trials])

    monkeypatch.setattr(further, "squares", squares)
    simulated, through, beside, kept = a_trial("panel_tilt", "panel_tilt", ("hem_weight",), ("panel_tilt",), left)
    assert bool(simulated) is kept is tried
    assert not tried or (simulated[0] == ["hem_weight"] and beside[0] is None and through[0] == ())


def test_of_many_that_come_as_near_the_nearest_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    near = {"panel_tilt": 1.0, "hem_weight": 2.9, "crease": 1.5, "panel_adhesion": 2.0, "off_grain": 1.1}

    def squares(looks: Any, trials: list[Any], scene: str, workers: Any) -> Any:
        return np.array([[near.get(trial[0][0], 9.0)] * 3 for trial in trials])

    monkeypatch.setattr(further, "squares", squares)
    simulated = a_trial("panel_tilt", "panel_tilt", ("panel_adhesion",), ("panel_tilt",), 2.0)[0]
    assert simulated[0] == ["off_grain", "crease", "panel_adhesion"] and len(simulated[0]) == further.MOST_AS_NEAR


def test_beside_a_camera_that_leads_they_are_chosen_and_simulated_through_it() -> None:
    _, through, beside, kept = a_trial("unknown", "camera_translation", ("panel_tilt", "camera_translation"))
    assert beside[0] == ("camera_translation", MOVED) and through[0] == (("camera_translation", MOVED),) and kept


def test_beside_an_effect_on_the_cloth_that_leads_they_are_chosen_alone() -> None:
    assert a_trial("unknown", "panel_tilt", ())[2][0] is None
