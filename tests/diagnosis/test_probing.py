"""Pins, weights and bends put on the cloth on trial, where the answer is open."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.afresh import probing
from diagnosis.afresh.probing import SURE, look_probed
from diagnosis.measurement.features import measure
from diagnosis.measurement.picture import picture_of
from diagnosis.measurement.reference import make_reference
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.probes import HOOKS, PROBES, TRIM_KG_M, TURN_RAD, probed
from diagnosis.simulation.responses import probe_responses
from diagnosis.simulation.simulator import Simulator
from diagnosis.simulation.variations import PIN_STEP_M, clean, smaller
from diagnosis.tasks.fabric_task import BASE_JITTER
from diagnosis.workers import ALONE
from simcore.mechanics import UniformCurvature
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

FABRIC = FabricParameters(1000.0, 800.0, 300.0, 2.5e-4, 2.5e-4, 2.5e-4, 0.2)


def test_each_probe_adds_to_what_is_there() -> None:
    rolled = UniformCurvature(warp=1.0)
    scene = SimulationScene(Setup.nominal("stretch")).with_mechanics(
        trim_kg_m=(0.1, 0.2, 0.3, 0.4), rest_curvature=(rolled,), off_grain_rad=0.2
    )
    found = probed(scene)
    assert {family: len(scenes) for family, scenes in found.items()} == dict(PROBES) and set(PROBES) == set(HOOKS)
    for number, changed in enumerate(found["weights"]):
        added = np.subtract(changed.mechanics.trim_kg_m, (0.1, 0.2, 0.3, 0.4))
        np.testing.assert_allclose(added, TRIM_KG_M * np.eye(4)[number], atol=1e-15)
        assert changed.with_mechanics(trim_kg_m=scene.mechanics.trim_kg_m) == scene
    for changed in found["bends"]:
        assert changed.mechanics.rest_curvature[0] == rolled and len(changed.mechanics.rest_curvature) == 2
    (turned,) = found["turns"]
    assert turned == scene.with_mechanics(off_grain_rad=0.2 + TURN_RAD)


def test_probes_go_on_from_the_state_itself(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A weight along the bottom edge does what a hem does, on the state's own cells; pins are told per metre."""
    simulator = Simulator(DrapeCache(tmp_path))
    scene = SimulationScene(Setup.nominal("stretch"))
    state = simulator.put_up(GridMesh(0.025), FABRIC, scene, 0, BASE_JITTER)
    found = probe_responses(simulator, FABRIC, scene, state)
    reference = make_reference(state.drape, smaller(scene), least_pixels=3)

    def change(changed: SimulationScene) -> Any:
        pictures = (picture_of(d.drape, smaller(scene)) for d in (simulator.proceed(state, FABRIC, changed), state))
        after, before = (measure(picture, reference, with_pixels=False).vector() for picture in pictures)
        return clean(after - before)

    hem = change(scene.with_mechanics(hem_kg_m=TRIM_KG_M))
    assert np.abs(hem).max() > 1e-4
    np.testing.assert_allclose(found["weights"][3], hem, atol=1e-7)
    x, y, z = scene.setup.pins_m["top_left"]
    moved = scene.with_setup(scene.setup.with_pins(top_left=(x, y + PIN_STEP_M, z)))
    np.testing.assert_allclose(found["pins"][1], change(moved) / PIN_STEP_M, atol=1e-4)
    assert {family: len(rows) for family, rows in found.items()} == {"pins": 6, **PROBES}
    spent = simulator.cost.simulations
    probe_responses(simulator, FABRIC, scene, state)
    assert simulator.cost.simulations == spent
    monkeypatch.setattr("diagnosis.simulation.probes.TRIM_KG_M", 2 * TRIM_KG_M)  # what was kept is of other probes
    heavier = probe_responses(simulator, FABRIC, scene, state)["weights"]
    assert simulator.cost.simulations == spent + PROBES["weights"] and not np.allclose(heavier, found["weights"])


@dataclass(frozen=True)
class Captured:
    id: str
    scene: str
    base: str
    responses: Any = field(default_factory=lambda: Responded({}))


@dataclass(frozen=True)
class Responded:
    probes: dict[str, Any]


@dataclass(frozen=True)
class Result:
    task: Any
    captures: tuple[Captured, ...]


@dataclass(frozen=True)
class Look:
    result: Result
    simulator: str = "own"

    def scene_of(self, capture: Captured) -> str:
        return f"stated for {capture.id}"


def answer(top: str, probability: float, *seconds: str) -> Any:
    """Of two effects each has the same."""
    named = () if top in ("none", "unknown") else (top, *seconds)
    return SimpleNamespace(top=top, named=named, probabilities=dict.fromkeys((top, *named), probability), left=None)


def no_weighing(*asked: Any) -> Any:
    raise AssertionError("nothing is to be weighed or tried here")


@pytest.fixture
def look(monkeypatch: pytest.MonkeyPatch) -> Look:
    monkeypatch.setattr(probing, "probe_responses", lambda *asked: {"pins": asked})
    captures = (Captured("one", "stretch", "state"), Captured("other", "hanging", "state"))
    return Look(Result(SimpleNamespace(parameters="fabric"), captures))


@pytest.mark.parametrize(
    "cause",
    [
        answer("none", 1.0),
        answer("unknown", SURE - 0.1),
        answer("crease", SURE - 0.01),
        answer("crease", 0.4, "edge_curl"),
        answer("dropout", 0.4, "edge_curl"),
        answer("bending_hysteresis", 0.55),
        answer("panel_friction", 0.55),
    ],
)
def test_an_open_answer_is_probed_in_one_scene(look: Any, cause: Any) -> None:
    one, other = look_probed({"f": look}, no_weighing, lambda results: cause, "stretch")["f"].result.captures
    assert one.responses.probes == {"pins": ("own", "fabric", "stated for one", "state")}
    assert other is look.result.captures[1]


@pytest.mark.parametrize(
    "cause",
    [
        answer("unknown", 0.999),
        answer("crease", 0.999),
        answer("crease", 0.499, "edge_curl"),
        answer("dropout", 0.6),
        answer("dropout", 0.4, "focal_scale"),
    ],
)
def test_a_sure_answer_and_one_in_the_pictures_are_not(look: Any, cause: Any) -> None:
    assert look_probed({"f": look}, no_weighing, lambda results: cause, "stretch")["f"] is look


@pytest.mark.parametrize(("first", "tries"), [("none", 1), ("crease", 1), ("unknown", 0)])
def test_the_catalogue_is_tried_before_probes_blame_something_unknown(
    look: Any, monkeypatch: pytest.MonkeyPatch, first: str, tries: int
) -> None:
    """Once, with what the probes say; folds that the trial finds are probed, too."""
    tried: list[Any] = []

    def look_further(looks: Any, weigh: Any, name: Any, scene: str, workers: Any) -> Any:
        (one, _), asked = looks["f"].result.captures, (weigh, scene, workers)
        assert one.responses.probes and asked == (no_weighing, "stretch", ALONE)
        tried.append(looks)
        return {"f": look}  # as if in other folds: without probes

    def name(results: list[Result]) -> Any:
        return answer("unknown" if results[0].captures[0].responses.probes else first, 0.9)

    monkeypatch.setattr(probing, "look_further", look_further)
    found = look_probed({"f": look}, no_weighing, name, "stretch")
    assert len(tried) == tries and found["f"].result.captures[0].responses.probes


def test_probes_that_find_nothing_try_nothing(look: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probing, "look_further", no_weighing)
    found = look_probed({"f": look}, no_weighing, lambda results: answer("none", 0.9), "stretch")
    assert found["f"].result.captures[0].responses.probes
