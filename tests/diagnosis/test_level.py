"""A capture's difference from a picture without the plane of its panel, and the fold states found with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis.afresh import refinement
from diagnosis.afresh.fresh import FreshLook, with_effects
from diagnosis.afresh.outcomes import at_state, bent, freshen
from diagnosis.afresh.refinement import look_again, seen_through
from diagnosis.effects import get_effect
from diagnosis.inference.cause import Cause
from diagnosis.inference.evidence import Evidence
from diagnosis.measurement.level import levelled, panel_plane, without_plane
from diagnosis.measurement.picture import picture_of, state_distance
from diagnosis.scene import SimulationScene
from diagnosis.simulation.base_state import nearest_state
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.guided import warp_to_picture
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from diagnosis.tasks.fabric_task import BASE_JITTER, CaptureTask, FabricTask, explain_fabric
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

Depth = NDArray[np.float32]
FABRIC = FabricParameters(1000.0, 800.0, 300.0, 2e-5, 2e-5, 2e-5, 0.2)
SCENE = SimulationScene(Setup.nominal("stretch"))
ROTATED = {"rx": 0.4, "ry": -0.9, "rz": 0.8}
ROTATION = ("camera_rotation", ROTATED)
MOVED = get_effect("camera_rotation").apply(SCENE, ROTATED)


@pytest.fixture(scope="module")
def simulator(shelf: DrapeCache) -> Simulator:
    return Simulator(shelf)


@pytest.fixture(scope="module")
def drape(simulator: Simulator) -> KeyedDrape:
    return simulator.put_up(GridMesh(0.02), FABRIC, SCENE, 0, BASE_JITTER)


def tilted(picture: Depth) -> Depth:
    """As if it were 11 mm further away and turned."""
    rows, columns = np.linspace(-1, 1, picture.shape[0])[:, None], np.linspace(-1, 1, picture.shape[1])[None]
    return (picture + np.where(picture > 0, 0.011 + 0.006 * columns - 0.004 * rows, 0.0)).astype(np.float32)


def test_an_offset_and_a_slope_of_the_whole_picture_are_taken_out_and_the_cloths_own_change_stays(
    drape: KeyedDrape,
) -> None:
    picture = picture_of(drape.drape, SCENE)
    changed = picture.copy()
    middle = (slice(picture.shape[0] // 2, picture.shape[0] // 2 + 9), slice(picture.shape[1] // 2, None, 40))
    changed[middle] += 0.02
    depth = tilted(changed)
    depth[3:9] = 0.0
    left = levelled(depth, picture, SCENE)
    np.testing.assert_allclose(left[depth > 0], (changed - picture)[depth > 0], atol=2e-6)
    assert np.isnan(left[depth == 0]).all()
    assert np.nanmax(np.abs(left)) > 0.019


def test_cloth_before_the_panel_in_one_of_the_two_does_not_tilt_the_plane(drape: KeyedDrape) -> None:
    picture = picture_of(drape.drape, SCENE)
    hidden = picture.copy()
    hidden[-picture.shape[0] // 5 :, : picture.shape[1] // 12] -= 0.04
    left = levelled(tilted(hidden), picture, SCENE)
    np.testing.assert_allclose(left, hidden - picture, atol=2e-4)


def test_without_a_panel_or_too_little_of_it_nothing_is_taken_out(drape: KeyedDrape) -> None:
    bare = replace(SCENE, setup=replace(SCENE.setup, panel=False))
    picture = picture_of(drape.drape, bare)
    left = levelled(tilted(picture), picture, bare)
    seen = picture > 0
    np.testing.assert_allclose(left[seen], (tilted(picture) - picture)[seen], atol=1e-7)
    assert np.isnan(left[~seen]).all()
    flat, few = np.full((40, 40), 0.01), np.zeros((40, 40), dtype=bool)
    few[:10] = True
    assert np.isnan(panel_plane(flat, few)).all()
    np.testing.assert_array_equal(without_plane(flat, panel_plane(flat, few)), flat)


def test_the_fold_state_that_a_capture_shows_does_not_depend_on_where_its_picture_lies(
    simulator: Simulator, drape: KeyedDrape
) -> None:
    other = other_state(simulator)
    for shown in (drape, other):
        depth = tilted(picture_of(shown.drape, SCENE))
        assert state_distance(depth, shown.drape, SCENE) < 1e-6
        target, _ = warp_to_picture(shown.drape, SCENE, depth)
        assert np.abs(target - shown.drape.vertices).max() < 3e-4  # cloth on the panel is lifted by 0.2 mm
        solved = simulator.cost.simulations
        found, near = nearest_state(simulator, FABRIC, SCENE, depth, [drape, other])
        assert near < 1e-6
        assert found.key == shown.key
        assert simulator.cost.simulations == solved


def test_what_a_capture_does_not_show_leads_nowhere(drape: KeyedDrape) -> None:
    """No data in the picture's left half, and nothing right of its border."""
    whole = picture_of(drape.drape, SCENE)
    _, seen = warp_to_picture(drape.drape, SCENE, whole)
    held = whole.copy()
    middle = whole.shape[1] // 2
    held[:, :middle] = 0.0
    target, right = warp_to_picture(drape.drape, SCENE, held)
    inside = SCENE.camera_from_panel
    columns = SCENE.camera.project(drape.drape.vertices @ inside[:3, :3].T + inside[:3, 3])[:, 0]
    assert seen[columns < middle - 3].any() and not right[columns < middle - 3].any()
    np.testing.assert_array_equal(right[columns > middle + 3], seen[columns > middle + 3])
    at_rest = np.maximum(drape.drape.vertices[:, 2], 2e-4)
    np.testing.assert_allclose(target[~right, 2], at_rest[~right], atol=1e-12)
    narrow = replace(SCENE, camera=replace(SCENE.camera, width=middle))
    _, left = warp_to_picture(drape.drape, narrow, np.ascontiguousarray(whole[:, :middle]))
    assert not left[columns > middle].any() and left.any()


def test_a_capture_leads_to_its_folds_wherever_its_picture_lies(tmp_path: Path) -> None:
    """Nothing is known beforehand but another state."""
    simulator = Simulator(DrapeCache(tmp_path))
    start = simulator.put_up(GridMesh(0.02), FABRIC, SCENE, 0, BASE_JITTER)
    shown = other_state(simulator)
    depth = tilted(picture_of(shown.drape, SCENE))
    found, near = nearest_state(simulator, FABRIC, SCENE, depth, [start])
    assert found.key != start.key
    assert near == pytest.approx(state_distance(depth, found.drape, SCENE))
    assert near < 0.5 * state_distance(depth, start.drape, SCENE)


@pytest.fixture
def look(simulator: Simulator, shelf: DrapeCache, drape: KeyedDrape) -> FreshLook:
    """A capture of another fold state through a camera that was turned, explained from a wrong state."""
    depth = picture_of(other_state(simulator).drape, MOVED)
    task = CaptureTask("c", 0, depth, SCENE, sensor_known=True)
    fabric = FabricTask("f", FABRIC, (0.07,) * 7, (task,), ("camera_rotation", "pin_spacing"), 0.02)
    look = FreshLook(simulator, explain_fabric(fabric, shelf))
    wrong = at_state(look, look.result.captures[0], drape, state_distance(depth, drape.drape, SCENE))
    look.result = replace(look.result, captures=(wrong,))
    return look


def other_state(simulator: Simulator) -> KeyedDrape:
    return simulator.put_up(GridMesh(0.02), FABRIC, SCENE, 1, BASE_JITTER)


def test_folds_are_looked_for_through_a_camera_that_stands_elsewhere(look: FreshLook, drape: KeyedDrape) -> None:
    depth = look.result.task.captures[0].depth
    (found,) = freshen(look, [ROTATION], "stretch").captures
    assert state_distance(depth, found.base.drape, MOVED) < 0.5 * state_distance(depth, drape.drape, MOVED)
    assert found.rms_m == pytest.approx(state_distance(depth, found.base.drape, MOVED))


def test_what_was_measured_beside_and_by_probes_stays_as_long_as_the_state_does(look: FreshLook) -> None:
    capture = look.result.captures[0]
    rows = capture.responses.effects["pin_spacing"]
    told = replace(capture.responses, beside={("pin_spacing", "camera_rotation"): rows}, probes={"pins": rows[0]})
    look.sizes["camera_rotation"] = [ROTATION[1]]
    kept = bent(look, replace(capture, responses=told), ["camera_rotation"])
    assert set(kept.beside) == {("pin_spacing", "camera_rotation")} and set(kept.probes) == {"pins"}
    (found,) = freshen(look, [ROTATION], "stretch").captures
    assert found.base is not capture.base and not found.responses.beside and not found.responses.probes


def test_cloth_is_seen_as_the_last_leader_says(look: FreshLook, drape: KeyedDrape) -> None:
    depth = look.result.task.captures[0].depth
    turned = seen_through(look, (ROTATION,))
    assert turned.through == (ROTATION,)
    assert turned.result.captures[0].rms_m == pytest.approx(state_distance(depth, drape.drape, MOVED))
    back = seen_through(turned, ())
    assert back.through == () and back.result.captures[0].rms_m == pytest.approx(look.result.captures[0].rms_m)


def test_a_state_that_was_found_stays_and_its_distance_is_that_through_the_camera(
    look: FreshLook, simulator: Simulator
) -> None:
    shown, depth = other_state(simulator), look.result.task.captures[0].depth
    right = at_state(look, look.result.captures[0], shown, state_distance(depth, shown.drape, SCENE))
    assert right.rms_m > 3e-4
    look.result = replace(look.result, captures=(right,))
    (found,) = freshen(look, [ROTATION], "stretch").captures
    assert found.base is shown
    assert found.rms_m < 1e-6


def test_the_camera_that_fits_is_looked_through_unless_an_effect_says_how_it_stands(look: FreshLook) -> None:
    (capture,) = look.result.captures
    assert look.seen(capture) == SCENE
    assert look.seen(capture, [ROTATION]) == MOVED
    look.through = (ROTATION,)
    assert look.seen(capture) == MOVED
    assert look.seen(capture, [ROTATION]) == MOVED
    closer = ("pin_spacing", {"magnitude": -0.006})
    assert look.seen(capture, [closer]).setup == with_effects(SCENE, [closer]).setup
    assert look.seen(capture, [closer]).pose == MOVED.pose


def test_what_is_simulated_beside_a_moved_camera_is_held_against_the_capture_through_it(
    look: FreshLook, simulator: Simulator, drape: KeyedDrape
) -> None:
    closer = ("pin_spacing", {"magnitude": -0.006})
    changed = with_effects(SCENE, [closer])
    shown = simulator.proceed(drape, FABRIC, changed)
    (capture,) = look.result.captures
    (task,) = look.result.task.captures
    depth = picture_of(shown.drape, replace(changed, pose=MOVED.pose))
    look.result = replace(look.result, task=replace(look.result.task, captures=(replace(task, depth=depth),)))
    look.through = (ROTATION,)
    assert look.drape(capture, [closer]).key == shown.key
    ((_, near),) = [known["c"] for known in look.found.values()]
    assert near < 1e-6


def test_a_state_that_an_effect_leaves_behind_is_judged_through_the_camera_that_fits(
    look: FreshLook, simulator: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = other_state(simulator)
    monkeypatch.setattr(FreshLook, "drape", lambda *_: shown)
    (capture,) = look.result.captures
    through_the_stated = state_distance(look.result.task.captures[0].depth, shown.drape, SCENE)
    look.result = replace(look.result, captures=(replace(capture, rms_m=0.9 * through_the_stated),))
    closer = ("pin_spacing", {"magnitude": -0.006})
    assert freshen(look, [closer], "stretch").captures[0].base is capture.base
    look.through = (ROTATION,)
    (found,) = freshen(look, [closer], "stretch").captures
    assert found.rms_m < 0.5 * through_the_stated


def test_a_camera_that_leads_is_looked_through_in_the_second_look(
    look: FreshLook, monkeypatch: pytest.MonkeyPatch
) -> None:
    def evidence(name: str, value: float, size: dict[str, float]) -> Evidence:
        return Evidence(name, value, value, {"f": value}, size, size, value, {})

    def weigh(results: Any, beside: Any) -> Cause:
        known = {"none": evidence("none", 0.0, {}), "camera_rotation": evidence("camera_rotation", 9.0, ROTATED)}
        return Cause({"none": 0.0, "camera_rotation": 1.0}, known, 9.0)

    monkeypatch.setattr(refinement, "freshen", lambda look, wanted, scene: look.result)
    assert look_again({"f": look}, weigh, "stretch")["f"].through == (ROTATION,)
    monkeypatch.setattr(refinement, "leader", lambda cause: None)
    assert look_again({"f": look}, weigh, "stretch")["f"].through == ()


@pytest.mark.parametrize("share", [0.0, 0.03, 0.2, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("step", [0.0025, 0.005])
def test_a_panel_that_reads_in_coarse_steps_keeps_its_place(step: float, share: float) -> None:
    """With steps coarser than the noise most readings are alike: the others are a step away and no outliers."""
    rng = np.random.default_rng(3)
    known = np.ones((60, 80), dtype=bool)
    reading = -0.009 + step * (rng.random(known.shape) < share)
    reading[:, :2] = 0.06  # cloth where the simulation shows the panel
    found = panel_plane(reading, known)
    assert found[0] == pytest.approx(-0.009 + step * share, abs=1.5e-4)
    assert np.abs(found[1:]).max() < 5e-4


def test_coarse_steps_over_a_turned_panel_leave_its_slope() -> None:
    rng = np.random.default_rng(4)
    known = np.ones((60, 80), dtype=bool)
    slope = np.linspace(-0.01, 0.01, 80)[None, :]
    reading = np.round((slope + 0.0003 * rng.standard_normal(known.shape)) / 0.005) * 0.005 - 0.006
    found = panel_plane(reading, known)
    assert found == pytest.approx([-0.006, 0.01, 0.0], abs=5e-4)
