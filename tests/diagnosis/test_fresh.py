"""Responses bent through fresh simulations, and what is common to all repeats but in no catalogue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.afresh import fresh, outcomes
from diagnosis.afresh.fresh import FreshLook
from diagnosis.afresh.outcomes import around, bend
from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, View
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.smooth_modes import smooth_modes
from diagnosis.inference.unknown import unknown_shape
from diagnosis.inference.view_likelihood import view_log_likelihood
from diagnosis.measurement.reference import CELLS
from diagnosis.scene import SimulationScene
from diagnosis.simulation.sizes import node_weights, nodes
from diagnosis.tasks.fabric_task import CaptureResult, FabricResult
from simcore.scenes import Setup
from tests.diagnosis.response_rows import random_rows, still_rows


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("air_draft", {"magnitude": 0.31}),
        ("crease", {"magnitude": -0.7, "down": 0.0, "position": 0.5}),
        ("crease", {"magnitude": 0.7, "down": 1.0, "position": 0.35}),
        ("stretch_stiffening", {"magnitude": 0.05}),
    ],
)
def test_bent_responses_pass_through_what_was_simulated(name: str, size: dict[str, float]) -> None:
    effect = get_effect(name)
    rng = np.random.default_rng(1)
    rows, wanted = random_rows(rng, name, 1.0, 5), rng.standard_normal(5)
    bent = bend(effect, rows, [(size, wanted)])
    np.testing.assert_allclose(node_weights(effect, size) @ bent, wanted, atol=1e-9)
    untouched = node_weights(effect, size) == 0
    np.testing.assert_array_equal(bent[untouched], rows[untouched])


def test_what_is_learnt_of_one_width_of_a_curl_nearly_holds_at_the_others() -> None:
    """A crease at one line says nothing of one at another line."""
    wanted = np.ones(5)
    for name, here, there, learnt in (
        ("edge_curl", {"width_m": 0.035}, {"width_m": 0.025}, 0.95),
        ("crease", {"down": 1.0, "position": 0.35}, {"down": 1.0, "position": 0.3}, 0.0),
    ):
        effect = get_effect(name)
        typical = effect.typical()
        bent = bend(effect, still_rows(name, 5), [(typical | here, wanted)])
        np.testing.assert_allclose(node_weights(effect, typical | here) @ bent, wanted, atol=1e-9)
        np.testing.assert_allclose(node_weights(effect, typical | there) @ bent, learnt * wanted, atol=1e-9)


def test_what_one_component_of_a_vector_changes_otherwise_is_not_put_down_to_another() -> None:
    """Turned far about x, a picture changes less than in proportion: that says nothing of a turn about z."""
    effect = get_effect("camera_rotation")
    x, y, z = np.random.default_rng(1).standard_normal((3, 40))

    def outcome(size: Mapping[str, float]) -> np.ndarray:
        return np.asarray(x * np.tanh(2.0 * size["rx"]) + y * size["ry"] + z * size["rz"])

    rows = np.stack([outcome(size) for size in nodes(effect)])
    found = {"rx": -0.4, "ry": 0.3, "rz": 0.3}
    more = found | {"rz": 0.9}

    def missed(known: Sequence[Mapping[str, float]], size: Mapping[str, float]) -> float:
        bent = bend(effect, rows, [(one, outcome(one)) for one in known])
        return float(np.abs(node_weights(effect, size) @ bent - outcome(size)).max())

    assert missed([found], found) < 1e-9
    assert missed([found], more) > 0.2  # put down to all by their lengths
    assert missed(around(effect, found), found) < 0.05
    assert missed(around(effect, found), more) < 0.05
    small = found | {"rz": 0.01}
    assert missed(around(effect, small), small | {"rz": 0.5}) < 0.05


def block_of(measured: np.ndarray) -> Block:
    """Two repeats whose errors are independent, 0.5 mm in each cell."""
    count = CELLS * CELLS
    factor = 0.0005 * np.eye(2 * count)
    view = View(measured / 0.0005, {}, {}, factor, float(2 * count * np.log(0.0005)))
    cell, owner = np.tile(np.arange(count), 2), np.repeat([0, 1], count)
    still = np.zeros((4, 2 * count))
    return Block("f1", "stretch", ("a", "b"), view, view, cell, owner, np.zeros((7, 2 * count)), still, still)


def test_a_smooth_change_that_repeats_share_is_better_explained_by_an_unknown_shape_than_by_errors() -> None:
    rng = np.random.default_rng(2)
    model = LikelihoodModel()
    shape = smooth_modes()[: CELLS * CELLS] @ rng.standard_normal(smooth_modes().shape[1]) * 0.003
    noise = 0.0005 * rng.standard_normal(2 * CELLS * CELLS)

    def gain(measured: np.ndarray) -> float:
        view = block_of(measured).stated
        nothing = view_log_likelihood(view, np.zeros((0, len(measured))), np.zeros((1, 0)), "stretch", model)[0]
        return float(unknown_shape(block_of(measured), model).max() - nothing)

    assert gain(np.tile(shape, 2) + noise) > 10.0
    assert gain(noise) < 0.0


TILT, OTHER_TILT = ("panel_tilt", {SCALAR: 8.0}), ("panel_tilt", {SCALAR: 6.0})
BLURRED = ("sensor_smoothing", {SCALAR: 1.0, "after_noise": 0.0})
CREASE = ("crease", {SCALAR: 1.0, "down": 1.0, "position": 0.5})


def state(key: str, distance_m: float) -> Any:
    """At rest, so far from the capture."""
    return SimpleNamespace(key=key, drape=SimpleNamespace(ok=True, mesh=None, distance=distance_m))


def one_capture(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Of a fabric with one capture, whose distance every state knows."""
    monkeypatch.setattr(fresh, "state_distance", lambda depth, drape, scene: drape.distance)
    monkeypatch.setattr(fresh, "drape_key", lambda mesh, fabric, setup, mechanics: repr((setup, mechanics)))
    seen = SimpleNamespace(id="seen", depth=None, scene=SimulationScene(Setup.nominal("stretch")))
    return SimpleNamespace(task=SimpleNamespace(captures=[seen], parameters=None))


def test_a_search_begins_where_as_many_of_the_effects_as_possible_are_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a tilt a crease is sought from the state with the tilt on, and led by the capture where that is far."""
    began: list[str] = []

    class Solver:
        def proceed(self, start: Any, fabric: Any, scene: Any) -> Any:
            began.append(start.key)
            return state("gone on from " + start.key, 2e-3)

        def led(self, start: Any, fabric: Any, scene: Any, depth: Any) -> Any:
            began.append("led")
            return state("led", 1e-3)

    simulator: Any = Solver()
    result = one_capture(monkeypatch)
    capture: Any = SimpleNamespace(id="seen", base=state("base", 3e-3), rms_m=3e-3)
    tilted, both = (state("tilted", 2e-3), 2e-3), (state("both", 2e-3), 2e-3)
    for known, sizes, expected in (
        ({}, [TILT, CREASE], ["base", "led"]),
        ({"panel_tilt": tilted}, [TILT, CREASE], ["tilted", "led"]),  # as near as the tilt alone is not near enough
        ({"panel_tilt": tilted}, [CREASE, TILT], ["base", "led"]),  # the last is the one that comes on
        ({"panel_tilt": tilted, "panel_tilt crease": both}, [OTHER_TILT, CREASE], ["both"]),  # as both at another size
        ({"panel_tilt": tilted}, [BLURRED, OTHER_TILT], ["tilted"]),  # what moves no cloth comes before or after
        ({"panel_tilt": tilted}, [OTHER_TILT, BLURRED], ["tilted"]),
    ):
        look = FreshLook(simulator, result, begun={("seen", names): state for names, state in known.items()})
        began.clear()
        look.drape(capture, sizes)
        assert began == expected


@pytest.mark.parametrize(
    ("near", "base", "landing", "began", "known", "first"),
    [
        (
            (2e-3, 1e-3),
            3e-3,
            1.1e-3,
            ["6"],
            (1.1e-3, 1e-3),
            "from 6",
        ),  # found at one size
        ((2e-3, 1e-3), 3e-3, 1.95e-3, ["6"], (2e-3, 1e-3), "6"),  # not where that is no nearer
        ((2e-3, 1.9e-3), 3e-3, 1e-3, [], (2e-3, 1.9e-3), "8"),  # sizes differ: as near as such things are
        ((3e-3, 2.9e-3), 2e-3, 2.1e-3, ["base", "base"], (2.1e-3, 2.1e-3), "from base"),  # nearest without the effect
    ],
)
def test_what_is_known_of_an_effect_is_of_the_folds_that_come_nearest(
    monkeypatch: pytest.MonkeyPatch,
    near: tuple[float, float],
    base: float,
    landing: float,
    began: list[str],
    known: tuple[float, float],
    first: str,
) -> None:
    """Tilts of 8 and 6 degrees, simulated before at some distances from the capture."""
    starts: list[str] = []

    class Solver:
        def proceed(self, start: Any, fabric: Any, scene: Any) -> Any:
            starts.append(start.key)
            return state("from " + start.key, landing)

    simulator: Any = Solver()
    result = one_capture(monkeypatch)
    capture: Any = SimpleNamespace(id="seen", base=state("base", base), rms_m=base)
    look = FreshLook(simulator, result, sizes={"panel_tilt": [TILT[1], OTHER_TILT[1]]})
    states = {"8": state("8", near[0]), "6": state("6", near[1])}
    for tilt, one in zip((TILT, OTHER_TILT), states.values(), strict=True):
        look.found[look._key(capture, look.seen(capture, [tilt]))] = {"seen": (one, one.drape.distance)}
    look.begun["seen", "panel_tilt"] = (states["8"], near[0])
    look.agree(capture, "panel_tilt")
    assert starts == began
    assert tuple(look.distance(capture, [tilt]) for tilt in (TILT, OTHER_TILT)) == known
    assert look.begun["seen", "panel_tilt"][0].key == first


def test_a_copy_learns_without_the_first_one_knowing() -> None:
    nothing: Any = None
    first = FreshLook(
        nothing, nothing, {"state": {}}, {}, {"crease": []}, {}, {"capture": {}}, {("crease", "draft"): []}
    )
    copy = first.copy()
    copy.found["state"]["capture"] = copy.begun["capture", "crease"] = nothing
    copy.found["other"] = {}
    copy.sizes["crease"].append({SCALAR: 1.0})
    copy.coarse["capture"] = nothing
    copy.beside["capture"]["crease", "draft"] = nothing
    copy.together["crease", "draft"].append([])
    assert (first.found, first.begun, first.sizes, first.coarse) == ({"state": {}}, {}, {"crease": []}, {})
    assert (first.beside, first.together) == ({"capture": {}}, {("crease", "draft"): []})


def test_folds_of_both_scenes_are_sought_through_a_camera_that_may_stand_elsewhere(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Those on the cloth are simulated for one scene alone."""
    camera, seen, solved = ("camera_translation", {"tx": 0.003, "ty": 0.0, "tz": 0.0}), [], []

    def through(look: Any, capture: Any, cameras: Any) -> Any:
        seen.append((capture.id, [name for name, _ in cameras]))
        return capture

    def nearest(look: Any, capture: Any, candidates: Any) -> Any:
        solved.append((capture.id, [name for name, _ in candidates]))
        return capture

    monkeypatch.setattr(outcomes, "_seen_through", through)
    monkeypatch.setattr(outcomes, "in_nearest_folds", nearest)
    monkeypatch.setattr(outcomes, "bent", lambda look, capture, names: sorted(names))
    captures = tuple(
        CaptureResult(scene, "f1", scene, 0, *(None,) * 3, 0.0, 0, True, None, True, None)  # type: ignore[arg-type]
        for scene in ("hanging", "stretch")
    )
    result: Any = FabricResult(None, captures)  # type: ignore[arg-type]
    look = FreshLook(Any, result)  # type: ignore[arg-type]
    found = outcomes.freshen(look, [TILT, camera], "stretch")
    assert seen == [("hanging", ["camera_translation"]), ("stretch", ["camera_translation"])]
    assert solved == [("stretch", ["panel_tilt"])]
    assert [c.responses for c in found.captures] == [["camera_translation"], ["camera_translation", "panel_tilt"]]


def test_what_diverged_is_no_start_and_shows_the_state_without_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing goes on from it, and it is infinitely far from every capture."""
    result = one_capture(monkeypatch)
    lost = state("lost", 1.0)
    lost.drape.ok, lost.drape.vertices = False, np.full((4, 3), np.nan)
    capture: Any = SimpleNamespace(id="seen", base=state("base", 2e-3), rms_m=2e-3)

    class Look(FreshLook):
        def _nearest(self, capture: Any, changed: Any, names: Any) -> Any:
            return lost

    class Solver:
        def proceed(self, *_: Any) -> Any:
            raise AssertionError("nothing goes on from what diverged")

    solver: Any = Solver()
    look = Look(solver, result)
    other: Any = "another fabric"
    assert look.drape(capture, [TILT], other) is lost and look.distance(capture, [TILT]) == np.inf
    monkeypatch.setattr(fresh, "picture_of", lambda drape, scene: drape)
    assert look.picture(capture, [TILT], other) is capture.base.drape
