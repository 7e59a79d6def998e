"""Captures whose folds the first search missed are told, and sought among more samples."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.measurement.picture import noise_square
from diagnosis.scene import SimulationScene, pose_rows
from diagnosis.simulation import missed_folds
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.missed_folds import further_states, is_missed
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from diagnosis.tasks import fabric_task
from diagnosis.tasks.fabric_task import CaptureTask, FabricTask, find_states
from renderer.sensor import SensorModel
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

SOFT = FabricParameters(817, 111, 52, 1.6e-5, 5e-6, 7e-6, 0.23)
STRETCH = SimulationScene(Setup.nominal("stretch"), sensor=SensorModel(range_noise_m=0.001))
HANGING = SimulationScene(Setup.nominal("hanging"), sensor=SensorModel(range_noise_m=0.001))


@pytest.mark.parametrize(
    ("distance_m", "repeats_m", "scene", "missed"),
    [
        (0.0040, (0.0013, 0.0040), STRETCH, True),  # one repeat alone is far
        (0.0013, (0.0013, 0.0040), STRETCH, False),
        (0.0040, (0.0039, 0.0040), STRETCH, False),  # both are: that is what an effect does
        (0.0015, (0.0013, 0.0015), STRETCH, False),
        (0.0040, (0.0013, 0.0040), HANGING, False),
        (0.0030, (0.0030,), STRETCH, True),  # no repeat to hold it against
        (0.0020, (0.0020,), STRETCH, False),
    ],
)
def test_what_is_far_in_one_repeat_alone_was_missed(
    distance_m: float, repeats_m: tuple[float, ...], scene: SimulationScene, missed: bool
) -> None:
    beyond = [repeat**2 - noise_square(scene) for repeat in repeats_m]
    assert is_missed(distance_m**2 - noise_square(scene), beyond, scene) is missed


def test_only_what_was_missed_is_sought_among_more(monkeypatch: pytest.MonkeyPatch) -> None:
    distances = {("a", False): 0.0013, ("b", False): 0.0040, ("b", True): 0.0014, ("c", False): 0.0014}
    asked: list[tuple[str, bool]] = []

    def find(simulator: Any, task: Any, capture: Any, found: Any = None, *, further: bool = False) -> tuple[Any, float]:
        asked.append((capture.id, further))
        state: Any = KeyedDrape(SimpleNamespace(ok=True), f"{capture.id} {further}")  # type: ignore[arg-type]
        return state, distances[capture.id, further]

    monkeypatch.setattr(fabric_task, "find_state", find)
    seen = tuple(CaptureTask(name, 0, np.zeros((1, 1), np.float32), STRETCH, True) for name in "abc")
    nothing: Any = None
    found = find_states(nothing, FabricTask("f", SOFT, (0.07,) * 7, seen, ()), seen)
    assert asked == [("a", False), ("b", False), ("c", False), ("b", True)]
    assert [(state.key, rms) for state, rms in found] == [("a False", 0.0013), ("b True", 0.0014), ("c False", 0.0014)]
    distances["b", True] = 0.0050  # farther than what was found first
    assert [state.key for state, _ in find_states(nothing, FabricTask("f", SOFT, (0.07,) * 7, seen, ()), seen)][1] == (
        "b False"
    )


def test_noise_that_grows_with_the_distance_is_no_missed_fold(monkeypatch: pytest.MonkeyPatch) -> None:
    pose = np.array(STRETCH.camera_from_panel)
    pose[2, 3] *= 1.5
    farther = replace(STRETCH, pose=pose_rows(pose))
    noise = {"near": noise_square(STRETCH), "far": noise_square(farther)}
    asked: list[bool] = []

    def find(simulator: Any, task: Any, capture: Any, found: Any = None, *, further: bool = False) -> tuple[Any, float]:
        asked.append(further)
        state: Any = KeyedDrape(SimpleNamespace(ok=True), "one")  # type: ignore[arg-type]
        return state, float(np.sqrt(noise[capture.id] + 1e-7))

    monkeypatch.setattr(fabric_task, "find_state", find)
    scenes = {"near": STRETCH, "far": farther}
    seen = tuple(CaptureTask(name, 0, np.zeros((1, 1), np.float32), scene, True) for name, scene in scenes.items())
    nothing: Any = None
    find_states(nothing, FabricTask("f", SOFT, (0.07,) * 7, seen, ()), seen)
    assert asked == [False, False]


def test_states_of_another_set_up_spare_no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    closer = HANGING.with_setup(HANGING.setup.with_pins(top_left=(-0.15, 0.0, 0.0)))
    given: dict[str, dict[str, float]] = {}

    def find(simulator: Any, task: Any, capture: Any, found: Any = None, *, further: bool = False) -> tuple[Any, float]:
        given[capture.id] = dict(found)
        state: Any = KeyedDrape(SimpleNamespace(ok=True), capture.id)  # type: ignore[arg-type]
        return state, 0.002

    monkeypatch.setattr(fabric_task, "find_state", find)
    scenes = {"a": HANGING, "b": closer, "c": HANGING}
    seen = tuple(CaptureTask(name, 0, np.zeros((1, 1), np.float32), scene, True) for name, scene in scenes.items())
    nothing: Any = None
    find_states(nothing, FabricTask("f", SOFT, (0.07,) * 7, seen, ()), seen)
    assert given == {"a": {}, "b": {}, "c": {"a": 0.002}}


def test_what_an_effect_does_with_pins_elsewhere_is_no_missed_fold(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wider pin distance shows the effect better; a magnet put back 1 mm off makes a repeat."""
    wider = STRETCH.with_setup(STRETCH.setup.with_pins(top_left=(-0.26, 0.0, 0.0)))
    again = STRETCH.with_setup(STRETCH.setup.with_pins(top_left=(-0.246, 0.0, 0.0)))
    distances = {"a": 0.003, "b": 0.008, "c": 0.003, "d": 0.008}
    asked: list[str] = []

    def find(simulator: Any, task: Any, capture: Any, found: Any = None, *, further: bool = False) -> tuple[Any, float]:
        if further:
            asked.append(capture.id)
        state: Any = KeyedDrape(SimpleNamespace(ok=True), capture.id)  # type: ignore[arg-type]
        return state, distances[capture.id]

    monkeypatch.setattr(fabric_task, "find_state", find)
    nothing: Any = None
    for scenes, missed in (({"a": STRETCH, "b": wider, "c": STRETCH}, []), ({"a": STRETCH, "d": again}, ["d"])):
        asked.clear()
        seen = tuple(CaptureTask(name, 0, np.zeros((1, 1), np.float32), scene, True) for name, scene in scenes.items())
        if len(scenes) == 3:  # alone in its set-up, it is sought on if it is as far as one capture alone may not be
            monkeypatch.setattr(missed_folds, "MISSED_ALONE_M", 0.02)
        find_states(nothing, FabricTask("f", SOFT, (0.07,) * 7, seen, ()), seen)
        assert asked == missed


def test_further_samples_rest_with_magnets_where_they_are_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(missed_folds, "FURTHER_SEEDS", range(100, 103))
    mesh = GridMesh(0.02)
    states = further_states(Simulator(DrapeCache(None)), SOFT, STRETCH, mesh)
    assert len(states) == 3
    for state in states:
        assert state.drape.ok
        np.testing.assert_allclose(state.drape.vertices[0], STRETCH.setup.pins_m["top_left"], atol=1e-12)
        np.testing.assert_allclose(state.drape.vertices[-1], STRETCH.setup.pins_m["bottom_right"], atol=1e-12)
    heights = np.stack([state.drape.vertices[:, 2] for state in states])
    assert float(np.ptp(heights, axis=0).max()) > 2e-3, "samples whose magnets were off rest in several fold states"
