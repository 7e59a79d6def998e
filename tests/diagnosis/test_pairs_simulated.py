"""Two effects that may be the answer are simulated together, the likeliest pairs alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from diagnosis.afresh import fresh, refinement, together
from diagnosis.afresh.fresh import FreshLook
from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.cause import Cause
from diagnosis.inference.pairs import Pair
from diagnosis.scene import SimulationScene
from diagnosis.simulation.responses import Responses
from diagnosis.simulation.sizes import node_weights
from diagnosis.tasks.fabric_task import CaptureResult
from simcore.scenes import Setup
from tests.diagnosis.pair_parts import Capture, evidence
from tests.diagnosis.response_rows import random_rows, still_rows

DRAFT, CREASE = {SCALAR: 0.4}, {SCALAR: 1.0, "down": 1.0, "position": 0.5}
SIZES: dict[str, Mapping[str, float]] = {"air_draft": DRAFT, "crease": CREASE}


def cause_of(pair_nats: float, second: str = "crease", size: float = 1.0, top: str = "air_draft") -> Cause:
    singles = {"none": evidence("none", 0.0), "air_draft": evidence("air_draft", 10.0, DRAFT)}
    own = SIZES[second] | {SCALAR: size} if second in SIZES else {SCALAR: size, "seed": 1.0}
    pair = Pair("air_draft", second, {"air_draft": DRAFT, second: own}, evidence(second, pair_nats))
    return Cause({name: float(name == top) for name in singles}, singles, 10.0, tried=(pair,))


def test_pairs_that_may_be_the_answer_are_simulated() -> None:
    assert [p.second for p in together.candidates(cause_of(9.0))] == ["crease"]
    assert [p.second for p in together.candidates(cause_of(10.1 - together.SOLVED_NATS))] == ["crease"]
    assert together.candidates(cause_of(10.0 - together.SOLVED_NATS)) == []
    assert together.candidates(cause_of(10.0 - together.LATER_NATS), together.LATER_NATS) == []
    assert together.candidates(cause_of(12.0, "bending_hysteresis")) == []


def test_only_the_likeliest_pairs_are_solved() -> None:
    ones = [cause_of(nats).tried[0] for nats in (8.0, 9.5, 9.0, 8.5)]
    likely = together.candidates(replace(cause_of(9.0), tried=tuple(ones)))
    assert [p.evidence.log_evidence for p in likely] == [9.5, 9.0]


def test_a_pair_that_is_worse_than_nothing_is_not_simulated() -> None:
    for none, expected in ((6.9, ["crease"]), (7.1, [])):
        cause = cause_of(7.0)
        cause = replace(cause, evidence={**cause.evidence, "none": evidence("none", none)})
        assert [p.second for p in together.candidates(cause)] == expected


def test_a_pair_on_the_cloth_is_not_solved_where_another_is_far_better() -> None:
    """Beside a camera that stands elsewhere, say: there folds are not what is left."""
    cause = cause_of(9.0)
    (crease,) = cause.tried
    for beyond, expected in ((-0.1, ["crease"]), (0.1, [])):
        better = evidence("camera_rotation", 9.0 + together.SOLVED_NATS + beyond)
        turned = Pair("air_draft", "camera_rotation", {}, better)
        assert [p.second for p in together.candidates(replace(cause, tried=(crease, turned)))] == expected


@pytest.mark.parametrize(
    ("sizes", "nats", "expected"),
    [
        ((1.0, 1.05), 9.0, [1.0]),
        ((1.0, 1.5), 9.0, [1.0, 1.5]),
        ((1.0, 1.5), 7.9, [1.0]),
        ((1.0, 1.5, 2.2, 3.2), 9.0, [1.0, 1.5, 2.2]),
    ],
)
def test_a_pair_is_simulated_again_only_where_its_sizes_moved_and_it_is_near(
    sizes: tuple[float, ...], nats: float, expected: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    simulated: list[float] = []

    def look(own: Any, change: partial[Any], scene: str) -> Any:
        simulated.extend(pair.sizes["crease"][SCALAR] for pair in change.keywords["pairs"])
        return own

    monkeypatch.setattr(together, "each_capture", look)
    causes = iter([cause_of(nats, size=size) for size in (*sizes, sizes[-1])])
    looks: Any = {"f1": SimpleNamespace(result=None)}
    together.look_together(looks, lambda _: next(causes), "stretch")
    assert simulated == expected


def test_both_responses_give_what_was_simulated_with_both_on() -> None:
    rng = np.random.default_rng(6)
    rows = {n: (random_rows(rng, n, 1.0, 9), np.zeros((1, 1))) for n in SIZES}
    change = rng.standard_normal(9)
    responses = Responses(np.zeros((7, 9)), np.zeros((8, 9)), np.zeros(9), np.zeros(9), rows, np.zeros(1))

    class Look(FreshLook):
        def drape(self, capture: Any, effects: Any, fabric: Any = None) -> Any:
            return SimpleNamespace(drape=SimpleNamespace(ok=capture.id != "lost"))

        def without_last(self, capture: Any, effects: Any) -> bool:
            return False

        def change(self, capture: Any, effects: Any) -> np.ndarray:
            assert [name for name, _ in effects] == ["air_draft", "crease"]
            return np.asarray(change * effects[1][1][SCALAR])

    nothing: Any = None
    pair = Pair("air_draft", "crease", SIZES, evidence("crease", 1.0))
    look, seen = Look(nothing, nothing), cast(CaptureResult, Capture("seen", responses))
    shown = together.with_both(look, seen, [pair])
    own = node_weights(get_effect("air_draft"), DRAFT) @ rows["air_draft"][0]

    def beside(size: float) -> np.ndarray:
        known = shown.responses.beside["crease", "air_draft"][0]
        return np.asarray(node_weights(get_effect("crease"), CREASE | {SCALAR: size}) @ known)

    np.testing.assert_allclose(own + beside(1.0), change, atol=1e-9)
    other = replace(pair, sizes=SIZES | {"crease": CREASE | {SCALAR: -0.5}})
    for _ in range(2):
        shown = together.with_both(look, shown, [other])  # what was known before is kept
    assert [sizes[1] for sizes in look.together["crease", "air_draft"]] == [
        ("crease", pair.sizes["crease"]) for pair in (pair, other)
    ]
    for size in (1.0, -0.5):
        np.testing.assert_allclose(own + beside(size), size * change, atol=0.15)
    measured = {("crease", "air_draft"): (rows["crease"][0] + 3.0, np.ones((1, 1)))}
    look = Look(nothing, nothing, beside={"seen": measured})
    shown = together.with_both(look, seen, [pair])
    np.testing.assert_allclose(own + beside(1.0), change, atol=1e-9)
    far = node_weights(get_effect("crease"), CREASE | {"down": 0.0}) @ measured["crease", "air_draft"][0]
    np.testing.assert_allclose(  # elsewhere it stays what was measured beside the first
        node_weights(get_effect("crease"), CREASE | {"down": 0.0}) @ shown.responses.beside["crease", "air_draft"][0],
        far,
    )
    lost = cast(CaptureResult, Capture("lost", responses))
    assert together.with_both(look, lost, [pair]).responses.beside == {}


@pytest.mark.parametrize(("left_mm", "ok", "nearer"), [(1.0, True, True), (2.9, True, False), (1.0, False, False)])
def test_what_the_second_effect_leaves_behind_is_the_firsts_where_it_is_nearer(
    left_mm: float, ok: bool, nearer: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def state(distance_mm: float, *, ok: bool = True) -> Any:
        return SimpleNamespace(drape=SimpleNamespace(ok=ok, mesh=None, distance=distance_mm / 1e3))

    class Look(FreshLook):
        def drape(self, capture: Any, effects: Any, fabric: Any = None) -> Any:
            return state(0.5) if len(effects) == 2 else state(3.0)

    turned = ("camera_rotation", {"rx": 0.0, "ry": 1.0, "rz": 0.0})

    def distance(depth: Any, drape: Any, scene: SimulationScene) -> float:
        assert scene.pose == get_effect(turned[0]).apply(seen.scene, turned[1]).pose
        return float(drape.distance)

    monkeypatch.setattr(fresh, "state_distance", distance)
    monkeypatch.setattr(fresh, "drape_key", lambda *what: "first alone")
    seen = SimpleNamespace(id="seen", depth=None, scene=SimulationScene(Setup.nominal("stretch")))
    left = state(left_mm, ok=ok)
    simulator: Any = SimpleNamespace(proceed=lambda start, fabric, scene: left)
    result: Any = SimpleNamespace(task=SimpleNamespace(captures=[seen], parameters=None))
    look = Look(simulator, result, found={"first alone": {}}, through=(turned,))
    capture: Any = SimpleNamespace(id="seen", base=state(4.0))
    assert look.without_last(capture, [("air_draft", DRAFT), ("crease", CREASE)]) is nearer
    assert look.found["first alone"] == ({"seen": (left, 0.001)} if nearer else {})


def test_what_is_only_rendered_is_tried_further_behind() -> None:
    singles = {"none": evidence("none", 0.0), "quantisation": evidence("quantisation", 20.0)}
    for second, expected in (("range_noise", 1), ("crease", 0)):
        pair = Pair("quantisation", second, {}, evidence(second, 20.1 - together.RENDERED_NATS))
        cause = Cause(dict.fromkeys(singles, 0.0), singles, 10.0, tried=(pair,))
        assert len(together.candidates(cause)) == expected


def test_what_a_second_effect_left_bends_the_firsts_responses(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {n: (still_rows(n, 9), np.zeros((1, 1))) for n in SIZES}
    responses = Responses(np.zeros((7, 9)), np.zeros((8, 9)), np.zeros(9), np.zeros(9), rows, np.zeros(1))
    fitted = replace(responses, effects=rows | {"air_draft": (rows["air_draft"][0] + 1.0, np.zeros((1, 1)))})
    monkeypatch.setattr(together, "bent", lambda look, capture, names: fitted if "air_draft" in names else None)
    known: list[Any] = []

    def in_nearest_folds(look: Any, capture: Any, new: Any) -> Any:
        known.extend(new)
        return capture

    monkeypatch.setattr(together, "in_nearest_folds", in_nearest_folds)
    lost = SimpleNamespace(drape=SimpleNamespace(ok=False))
    look: Any = SimpleNamespace(
        sizes={},
        beside={},
        together={},
        without_last=lambda capture, effects: True,
        drape=lambda capture, both: lost,
    )
    pair = Pair("air_draft", "crease", SIZES, evidence("crease", 1.0))
    found = together.with_both(look, cast(CaptureResult, Capture("seen", responses)), [pair])
    assert found.responses.effects is fitted.effects and look.sizes == {"air_draft": [DRAFT]}
    assert known == [("air_draft", DRAFT)]


def test_where_something_unknown_is_likeliest_the_likeliest_effects_are_looked_at_all_the_same() -> None:
    singles = {
        "none": evidence("none", 0.0),
        "unknown": evidence("unknown", 40.0),
        "air_draft": evidence("air_draft", 10.0, DRAFT),
    }
    cause = Cause({"none": 0.0, "unknown": 1.0, "air_draft": 0.0}, singles, 40.0)
    assert refinement.candidates(cause) == [("air_draft", DRAFT)]
    likely = replace(cause, probabilities={"none": 0.1, "unknown": 0.8, "air_draft": 0.1 + 1e-9})
    assert refinement.leader(likely) == "air_draft"
    assert refinement.leader(replace(cause, probabilities={"none": 0.2, "unknown": 0.8, "air_draft": 0.0})) is None
