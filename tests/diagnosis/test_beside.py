"""What a second effect changes where the likeliest one is on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.afresh import beside
from diagnosis.afresh.fresh import FreshLook, Sized, with_effects
from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.cause import Cause
from diagnosis.inference.evidence import Evidence
from diagnosis.inference.pairs import Pair
from diagnosis.measurement.features import measure
from diagnosis.measurement.picture import picture_of
from diagnosis.measurement.reference import make_reference
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.responses import Responses, find_responses, responses_with
from diagnosis.simulation.simulator import Simulator
from diagnosis.simulation.sizes import node_values, nodes
from diagnosis.tasks.fabric_task import BASE_JITTER
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup
from tests.diagnosis.response_rows import random_rows, still_rows

TILT = {SCALAR: 8.0}
NAMES = ("panel_tilt", "air_draft", "crease", "panel_friction", "camera_rotation", "bending_hysteresis", "dropout")


def cause_of(first: str, second: str | None = None) -> Cause:
    """One effect, or two, for certain."""
    singles = {name: Evidence(name, 0.0, 0.0, {}, TILT, TILT, 0.0, {}) for name in ("none", *NAMES)}
    probabilities = dict.fromkeys(singles, 0.0) | {first: 0.51 if second else 1.0}
    if second is None:
        return Cause(probabilities, singles, 10.0)
    pair = Pair(first, second, {first: TILT, second: TILT}, singles[second])
    return Cause(probabilities | {second: 0.49}, singles, 10.0, pair, 1.0)


@dataclass(frozen=True)
class Captured:
    """What of a capture's result is needed."""

    id: str
    scene: str
    responses: Responses
    base: Any = None


@dataclass(frozen=True)
class Fabric:
    """What of a fabric's result is needed."""

    task: Any
    captures: tuple[Captured, ...]


class Look(FreshLook):
    """Says what it was asked to simulate."""

    asked: list[tuple[str, list[Sized]]]

    def drape(self, capture: Any, effects: Sequence[Sized], fabric: Any = None) -> Any:
        self.asked.append((capture.id, list(effects)))
        return SimpleNamespace(drape=SimpleNamespace(ok=capture.id != "lost"))

    def seen(self, capture: Any, effects: Sequence[Sized] = ()) -> Any:
        return with_effects(SimulationScene(Setup.nominal("stretch")), effects)


def look_of(*captures: tuple[str, str]) -> Look:
    rows = {n: (still_rows(n, 3), np.zeros((1, 1))) for n in NAMES}
    known = {("dropout", "quantisation"): (np.ones((1, 3)), np.ones((1, 1)))}
    responses = Responses(np.zeros((7, 3)), np.zeros((8, 3)), np.zeros(3), np.zeros(3), rows, np.zeros(1), known)
    simulator: Any = None
    result: Any = Fabric(SimpleNamespace(parameters="own"), tuple(Captured(*own, responses) for own in captures))
    look = Look(simulator, result)
    look.asked = []
    return look


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """What responses were asked for; each is all ones."""
    asked: list[tuple[Any, ...]] = []

    def responses(simulator: Any, fabric: Any, scene: SimulationScene, state: Any, without: Mapping[str, Any]) -> Any:
        asked.append((fabric, scene, list(without)))
        return {name: (np.ones_like(rows), pixels) for name, (rows, pixels) in without.items()}

    monkeypatch.setattr(beside, "responses_with", responses)
    return asked


def test_second_effects_on_the_cloth_are_measured_with_the_first_on(measured: list[tuple[Any, ...]]) -> None:
    """Not its twin, what holds the cloth, differs from repeat to repeat, or moves no cloth; in one scene only."""
    look = look_of(("one", "stretch"), ("lost", "stretch"), ("other", "hanging"))
    seen = beside.look_beside({"f1": look}, cause_of("panel_tilt"), "stretch")["f1"]
    assert look.asked == [("one", [("panel_tilt", TILT)]), ("lost", [("panel_tilt", TILT)])]
    ((fabric, scene, effects),) = measured
    assert (fabric, effects) == ("own", ["crease"])
    nominal = SimulationScene(Setup.nominal("stretch"))
    assert scene == with_effects(nominal, [("panel_tilt", TILT)]) != nominal
    one, lost, other = (capture.responses.beside for capture in seen.result.captures)
    assert set(one) == {("dropout", "quantisation"), ("crease", "panel_tilt")}
    assert (one["crease", "panel_tilt"][0] == 1.0).all()
    assert set(lost) == set(other) == {("dropout", "quantisation")}
    assert set(seen.beside) == {"one"} and set(seen.beside["one"]) == {("crease", "panel_tilt")}


def test_a_size_that_was_simulated_serves_where_it_is_near(measured: list[tuple[Any, ...]]) -> None:
    for simulated, used in ((7.7, 7.7), (6.0, 8.0)):
        look = look_of(("one", "stretch"))
        look.sizes["panel_tilt"] = [{SCALAR: 3.0}, {SCALAR: simulated}]
        beside.look_beside({"f1": look}, cause_of("panel_tilt"), "stretch")
        assert look.asked == [("one", [("panel_tilt", {SCALAR: used})])]


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("none", None),
        ("camera_rotation", None),
        ("bending_hysteresis", None),
        ("panel_friction", None),
        ("panel_tilt", "dropout"),
    ],
)
def test_nothing_is_measured_where_no_effect_on_the_cloth_leads_or_another_one_explains_the_rest(
    first: str, second: str | None, measured: list[tuple[Any, ...]]
) -> None:
    looks = {"f1": look_of(("one", "stretch"))}
    assert beside.look_beside(looks, cause_of(first, second), "stretch") == looks
    assert measured == [] and looks["f1"].asked == []


def test_nothing_is_measured_beside_what_leads_unnamed_and_does_not_move_the_cloth(
    measured: list[tuple[Any, ...]],
) -> None:
    looks, cause = {"f1": look_of(("one", "stretch"))}, cause_of("camera_rotation")
    evidence = {**cause.evidence, "unknown": replace(cause.evidence["none"], name="unknown")}
    cause = replace(
        cause, probabilities={**cause.probabilities, "camera_rotation": 0.4, "unknown": 0.6}, evidence=evidence
    )
    assert cause.named == ()
    assert beside.look_beside(looks, cause, "stretch") == looks
    assert measured == [] and looks["f1"].asked == []


def test_a_draft_beside_a_strong_one_moves_the_cloth_by_what_both_change_more_than_one(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """On cells of 20 mm the response is the change itself: between two simulations that both have the first effect."""
    simulator = Simulator(DrapeCache(tmp_path_factory.mktemp("drapes")))
    fabric, mesh = FabricParameters(1000.0, 800.0, 300.0, 1.5e-5, 1.5e-5, 1.5e-5, 0.2), GridMesh(0.02)
    scene = with_effects(SimulationScene(Setup.nominal("stretch")), [("panel_adhesion", {SCALAR: 1.0})])
    state = simulator.put_up(mesh, fabric, scene, 0, BASE_JITTER)
    unused = {"air_draft": (still_rows("air_draft"), still_rows("air_draft"))}  # all of its places are as probable
    found = responses_with(simulator, fabric, scene, state, unused)["air_draft"][0]
    draft = get_effect("air_draft")
    sizes = [size[SCALAR] for size in nodes(draft)]
    weak = sizes.index(min(size for size in sizes if size > 0.0))
    coarse = simulator.coarser(state, fabric, scene)
    blown = draft.apply(scene, {SCALAR: sizes[weak]})
    own = make_reference(coarse.drape, scene)
    change = (
        measure(picture_of(simulator.proceed(coarse, fabric, blown).drape, blown), own, with_pixels=False).vector()
        - measure(picture_of(coarse.drape, scene), own, with_pixels=False).vector()
    )
    both = np.isfinite(change)
    error = np.sqrt(np.mean((found[weak][both] - change[both]) ** 2))
    assert error < 0.2 * np.sqrt(np.mean(change[both] ** 2))  # seen by half as many pixels
    strong = sizes.index(max(sizes))
    np.testing.assert_allclose(found[strong], 2.0 * found[weak])  # not simulated: in proportion
    before = simulator.cost.simulations
    responses_with(simulator, fabric, scene, state, unused)
    assert simulator.cost.simulations == before
    picture = picture_of(state.drape, scene)
    full = find_responses(simulator, fabric, scene, state, ["air_draft"], picture, make_reference(state.drape, scene))
    assert not np.allclose(full.effects["air_draft"][0][strong], 2.0 * full.effects["air_draft"][0][weak])


def test_less_probable_places_beside_another_effect_are_taken_from_what_is_known_without_it(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    simulator = Simulator(DrapeCache(tmp_path_factory.mktemp("drapes")))
    fabric, mesh = FabricParameters(1000.0, 800.0, 300.0, 1.5e-5, 1.5e-5, 1.5e-5, 0.2), GridMesh(0.05)
    scene = with_effects(SimulationScene(Setup.nominal("stretch")), [("air_draft", {SCALAR: 0.2})])
    state, crease = simulator.put_up(mesh, fabric, scene, 0, BASE_JITTER), get_effect("crease")
    picture = picture_of(state.drape, scene)
    seen = find_responses(simulator, fabric, scene, state, [], picture, make_reference(state.drape, scene))
    rng = np.random.default_rng(3)
    known = random_rows(rng, "crease", 1.0, seen.mesh.size), random_rows(rng, "crease", 1.0, seen.sensed.size)
    before = simulator.cost.simulations
    vector, pixels = responses_with(simulator, fabric, scene, state, {"crease": known})["crease"]
    middle = np.repeat([place["position"] == 0.5 for place in crease.tried], len(node_values(crease)))
    assert simulator.cost.simulations == before + 4  # half sizes of either sign, down and across
    np.testing.assert_array_equal(vector[~middle], known[0][~middle])
    np.testing.assert_array_equal(pixels[~middle], known[1][~middle])
    assert (pixels[middle] == 0.0).all() and np.abs(vector[middle]).max() > 1e-5


def test_beside_what_differs_from_repeat_to_repeat_it_is_measured_too(measured: list[tuple[Any, ...]]) -> None:
    look = look_of(("one", "stretch"))
    beside.look_beside({"f1": look}, cause_of("panel_tilt", "bending_hysteresis"), "stretch")
    assert look.asked == [("one", [("panel_tilt", TILT)])] and len(measured) == 1
