"""Parameters are sought of which the network says the same, with the effects on, as of the captures."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from capture.capture_set import CAPTURES_FILE, CaptureSet
from capture.normalise import NetworkInput, normalise_depth
from capture.prepare import prepare_all
from diagnosis import indirect_estimate as module
from diagnosis.effects import parse_effect
from diagnosis.extension import AppliedEffect, SimulatorExtension
from diagnosis.indirect_estimate import (
    LONGEST_STEP,
    STEPS,
    UNSURE,
    Array,
    IndirectEstimate,
    IndirectEstimator,
)
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Simulator
from diagnosis.synthesis import draw_fabrics, make_capture_set, real_fabric
from diagnosis.tasks.fabric_task import BASE_SEEDS
from diagnosis.tasks.parameters import INTERVAL_90
from simcore.drape import DrapeStatus
from simcore.errors import InputError, SimulationError
from simcore.parameters import ESTIMATED_NAMES, LIMITS
from tests.diagnosis.conftest import PLAN
from trainer.predict import Estimator
from trainer.shipped import DEFAULT_MODEL

CELL_M = 0.02
HELD = replace(PLAN, scenes=("hanging", "stretch"), pin_radius_m=0.01, repeats=1, resolution_m=CELL_M)
FABRICS = dict(enumerate(draw_fabrics(2, HELD.seed)))
NEARER = "pin_spacing=-0.008"
Make = Callable[..., IndirectEstimator]
Says = Callable[[Array], Array]


def extension(*texts: str) -> SimulatorExtension:
    """A simulator file's content."""
    parsed = [parse_effect(text) for text in texts]
    return SimulatorExtension(effects=tuple(AppliedEffect(name=e.name, size=e.size(size)) for e, size in parsed))


def logs(parameters: dict[str, float]) -> Array:
    """The six, in ln p."""
    return np.log([parameters[name] for name in ESTIMATED_NAMES])


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory, shelf: DrapeCache) -> CaptureSet:
    """Two fabrics, once in each scene, the magnets too near to each other."""
    return make_capture_set(tmp_path_factory.mktemp("near"), HELD, [parse_effect(NEARER)], fabrics=FABRICS, cache=shelf)


@pytest.fixture(scope="module")
def network() -> Estimator:
    return Estimator.load(DEFAULT_MODEL)


@pytest.fixture
def make(captures: CaptureSet, network: Estimator, shelf: DrapeCache) -> Make:
    """``make("pin_spacing=-0.008", ...)``: an estimator of the set with these effects on."""

    def with_effects(*texts: str) -> IndirectEstimator:
        ready = prepare_all(captures.captures)
        return IndirectEstimator(captures, ready, extension(*texts), network, Simulator(shelf), CELL_M)

    return with_effects


def test_estimates_come_nearer_to_the_cloth_s_own(make: Make) -> None:
    indirect = make(NEARER)
    before, after = [], []
    for number, stated in FABRICS.items():
        found = indirect.estimate(f"f{number + 1}", stated.density)
        cloth = logs(real_fabric(HELD, number, stated, first=number == 0).as_dict())
        before.append(np.sqrt(np.mean((logs(found.first.parameters) - cloth) ** 2)))
        after.append(np.sqrt(np.mean((logs(found.estimate.parameters) - cloth) ** 2)))
        assert found.simulations == (STEPS + 1) * sum(BASE_SEEDS.values()) and found.unrested == 0
        assert found.left < 0.4
    assert np.mean(after) < 0.85 * np.mean(before)


@pytest.fixture
def told(make: Make, monkeypatch: pytest.MonkeyPatch) -> Callable[[Says], tuple[IndirectEstimate, list[Array]]]:
    """What comes of a network that says this of simulations, and the cloths that were simulated; both in ln p."""

    def estimate(says: Says) -> tuple[IndirectEstimate, list[Array]]:
        asked: list[Array] = []

        def answer(_: IndirectEstimator, fabric: str, density: float, cloth: Array) -> Array:
            asked.append(cloth)
            return says(cloth)

        monkeypatch.setattr(IndirectEstimator, "_says", answer)
        return make(NEARER).estimate("f1", FABRICS[0].density), asked

    return estimate


def test_a_shift_is_taken_back(told: Callable[[Says], tuple[IndirectEstimate, list[Array]]]) -> None:
    found, asked = told(lambda cloth: cloth + 0.4)
    assert len(asked) == STEPS + 1 and np.allclose(asked[0], logs(found.first.parameters))
    assert np.allclose(logs(found.estimate.parameters), logs(found.first.parameters) - 0.4)
    assert found.left == pytest.approx(0.0, abs=1e-9)


def test_intervals_move_along_and_widen(told: Callable[[Says], tuple[IndirectEstimate, list[Array]]]) -> None:
    found, _ = told(lambda cloth: cloth + np.array([0.4, 0.0, 0.0, 0.0, 0.0, 0.0]))
    first, then = found.first, found.estimate
    for name, by in zip(ESTIMATED_NAMES, (0.4, 0.0, 0.0, 0.0, 0.0, 0.0), strict=True):
        for old, new in zip(first.intervals_90[name], then.intervals_90[name], strict=True):
            was, now = math.log(old / first.parameters[name]), math.log(new / then.parameters[name])
            assert now == pytest.approx(math.copysign(math.hypot(was, INTERVAL_90 * UNSURE * by), was))
    assert then.out_of_distribution == first.out_of_distribution and then.scenes == first.scenes


def test_no_step_is_longer_than_one_answer_is_believed(
    told: Callable[[Says], tuple[IndirectEstimate, list[Array]]],
) -> None:
    far = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.5])
    found, asked = told(lambda cloth: cloth + far)
    assert np.allclose(np.diff([cloth[-1] for cloth in asked]), [-LONGEST_STEP, -LONGEST_STEP, -0.5])
    assert found.left == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("by", [-40.0, 40.0])
def test_estimates_stay_within_what_a_fabric_may_have(
    by: float, told: Callable[[Says], tuple[IndirectEstimate, list[Array]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "STEPS", 30)
    found, _ = told(lambda cloth: cloth + by)
    for name in ESTIMATED_NAMES:
        low, high = LIMITS[name]
        lower, upper = found.estimate.intervals_90[name]
        assert low <= lower <= found.estimate.parameters[name] <= upper <= high


def test_what_scatters_repeats_is_another_one_in_every_simulation(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    put_up, seen = Simulator.put_up, []

    def noted(simulator: Simulator, mesh: object, fabric: object, scene: object, **words: object) -> object:
        seen.append(scene)
        return put_up(simulator, mesh, fabric, scene, **words)  # type: ignore[arg-type]

    monkeypatch.setattr(Simulator, "put_up", noted)
    monkeypatch.setattr(module, "STEPS", 0)
    make("bending_hysteresis=8").estimate("f1", FABRICS[0].density)
    shown = [(scene.setup.scene, scene.mechanics.rest_curvature[0].seed) for scene in seen]  # type: ignore[attr-defined]
    assert len(set(shown)) == len(shown) == sum(BASE_SEEDS.values())


def test_effects_of_no_use_to_a_capture_are_refused_before_anything_is_simulated(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Simulator, "put_up", lambda *_, **__: pytest.fail("simulated"))
    with pytest.raises(InputError, match="panel_tilt 95 is out of range"):
        make("panel_tilt=95")


def test_what_is_in_poses_that_were_found_is_not_simulated_again(
    captures: CaptureSet, network: Estimator, shelf: DrapeCache, tmp_path: Path
) -> None:
    """A turned camera turns the pose that is found; a draft does not."""
    shutil.copytree(captures.folder, tmp_path / "set")
    path = tmp_path / "set" / CAPTURES_FILE
    document = json.loads(path.read_text())
    document["setup"]["camera_from_panel"] = None
    path.write_text(json.dumps(document))
    unposed = CaptureSet.load(tmp_path / "set")

    def make(*texts: str) -> IndirectEstimator:
        ready = prepare_all(unposed.captures)
        return IndirectEstimator(unposed, ready, extension(*texts), network, Simulator(shelf), CELL_M)

    both = make("camera_rotation=rx:1,ry:0,rz:0", "depth_bias=0.005", "air_draft=0.2")
    assert both.in_poses == ("camera_rotation", "depth_bias")
    for shown in (one for some in both._shown.values() for one in some):
        seen = shown.with_effects(0)
        assert (
            seen.pose == shown.scene.pose
            and seen.sensor == shown.scene.sensor
            and seen.mechanics != shown.scene.mechanics
        )
    with pytest.raises(InputError, match=r"camera_rotation: .*state camera_from_panel") as caught:
        make("camera_rotation=rx:1,ry:0,rz:0")
    assert caught.value.code == "effects_in_poses"


def test_one_capture_without_a_pose_takes_no_effect_from_the_others(
    captures: CaptureSet, network: Estimator, shelf: DrapeCache, tmp_path: Path
) -> None:
    shutil.copytree(captures.folder, tmp_path / "set")
    path = tmp_path / "set" / CAPTURES_FILE
    document = json.loads(path.read_text())
    document["captures"][0]["setup"] = {"camera_from_panel": None}
    path.write_text(json.dumps(document))
    mixed, turned = CaptureSet.load(tmp_path / "set"), extension("camera_rotation=rx:1,ry:0,rz:0")
    one = IndirectEstimator(mixed, prepare_all(mixed.captures), turned, network, Simulator(shelf), CELL_M)
    assert one.in_poses == ("camera_rotation",)
    kept = [shown.with_effects(0).pose == shown.scene.pose for some in one._shown.values() for shown in some]
    assert kept == [True, *[False] * (len(mixed.captures) - 1)]


def test_poses_that_are_stated_leave_every_effect(make: Make) -> None:
    turned = make("camera_rotation=rx:1,ry:0,rz:0")
    assert turned.in_poses == ()
    for shown in (one for some in turned._shown.values() for one in some):
        assert shown.with_effects(0).pose != shown.scene.pose


def test_a_simulation_that_shows_the_network_nothing_is_told(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    def flat(*words: object) -> NetworkInput:
        seen = normalise_depth(*words)  # type: ignore[arg-type]
        return replace(seen, height=np.zeros_like(seen.height))

    monkeypatch.setattr(module, "normalise_depth", flat)
    with pytest.raises(InputError, match=r"'f1' simulated with the effects on: .*shows no cloth") as caught:
        make(NEARER).estimate("f1", FABRICS[0].density)
    assert caught.value.code == "no_cloth"


def test_a_cloth_that_diverges_is_told(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    vertices = np.full((4, 3), np.nan)
    drape = SimpleNamespace(ok=False, vertices=vertices, reason="step not finite", status=DrapeStatus.DIVERGED)
    monkeypatch.setattr(Simulator, "put_up", lambda *_, **__: SimpleNamespace(drape=drape))
    with pytest.raises(SimulationError, match=r"'f1' cannot be simulated in hanging .*step not finite") as caught:
        make(NEARER).estimate("f1", FABRICS[0].density)
    assert caught.value.code == "effects_diverged"


def test_what_did_not_come_to_rest_is_counted(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    put_up = Simulator.put_up

    def moving(simulator: Simulator, *words: object, **more: object) -> object:
        found = put_up(simulator, *words, **more)  # type: ignore[arg-type]
        return replace(found, drape=replace(found.drape, status=DrapeStatus.NOT_STILL))

    monkeypatch.setattr(Simulator, "put_up", moving)
    monkeypatch.setattr(module, "STEPS", 0)
    found = make(NEARER).estimate("f2", FABRICS[1].density)
    assert found.unrested == found.simulations == sum(BASE_SEEDS.values())


def test_a_set_that_cannot_be_simulated_is_refused(captures: CaptureSet, network: Estimator, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"resolution 0\.3 m"):
        IndirectEstimator(
            captures, prepare_all(captures.captures), extension(NEARER), network, Simulator(DrapeCache(None)), 0.3
        )
