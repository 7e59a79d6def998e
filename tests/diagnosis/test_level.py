"""A capture's difference from a picture without the plane of its panel, and the fold states found with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis.base_state import nearest_state, picture_of, state_distance, warp_to_picture
from diagnosis.drape_cache import DrapeCache
from diagnosis.effects import get_effect
from diagnosis.fabric_task import BASE_JITTER, CaptureTask, FabricTask, explain_fabric
from diagnosis.fresh import FreshLook, at_state, freshen
from diagnosis.level import levelled, panel_plane, without_plane
from diagnosis.scene import SimulationScene
from diagnosis.simulator import KeyedDrape, Simulator
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

Depth = NDArray[np.float32]
FABRIC = FabricParameters(1000.0, 800.0, 300.0, 2e-5, 2e-5, 2e-5, 0.2)
SCENE = SimulationScene(Setup.nominal("stretch"))
ROTATED = {"rx": 0.4, "ry": -0.9, "rz": 0.8}


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
    left = levelled(tilted(changed), picture, SCENE)
    np.testing.assert_allclose(left, changed - picture, atol=2e-6)
    assert np.abs(left).max() > 0.019


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
    other = simulator.put_up(GridMesh(0.02), FABRIC, SCENE, 1, BASE_JITTER)
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


def test_folds_are_looked_for_through_a_camera_that_stands_elsewhere(
    simulator: Simulator, shelf: DrapeCache, drape: KeyedDrape
) -> None:
    other = simulator.put_up(GridMesh(0.02), FABRIC, SCENE, 1, BASE_JITTER)
    rotation = ("camera_rotation", ROTATED)
    moved = get_effect(rotation[0]).apply(SCENE, ROTATED)
    depth = picture_of(other.drape, moved)
    task = CaptureTask("c", 0, depth, SCENE, sensor_known=True)
    fabric = FabricTask("f", FABRIC, (0.07,) * 7, (task,), ("camera_rotation",), 0.02)
    first = explain_fabric(fabric, shelf)
    look = FreshLook(simulator, first)
    start = at_state(look, first.captures[0], drape, state_distance(depth, drape.drape, SCENE))
    look.result = replace(first, captures=(start,))
    assert look.seen(start) == SCENE
    assert look.seen(start, [rotation]) == moved
    (found,) = freshen(look, [rotation], "stretch").captures
    assert state_distance(depth, found.base.drape, moved) < 0.5 * state_distance(depth, drape.drape, moved)
    assert found.rms_m == pytest.approx(state_distance(depth, found.base.drape, moved))
    look.through = (rotation,)
    assert look.seen(start) == moved
    assert look.seen(start, [rotation]) == moved
