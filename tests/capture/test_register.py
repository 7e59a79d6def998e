"""Poses found against the poses that made the pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from capture.capture_set import CaptureSet
from capture.edges import _height_map
from capture.plane import Plane
from capture.prepare import prepare_all
from capture.register import Registration, register, rigid_fit
from capture.segment import segment_cloth
from renderer.pose import invert_pose, pose_from_rotation
from simcore.errors import InputError
from simcore.scenes import Scene, Setup
from tests.capture.conftest import MakeSet
from tests.capture.sheets import CAMERA, Sheet, difference, make_sheet, turned_pose, with_noise

degrees = st.floats(-10.0, 10.0)
small = st.floats(-0.05, 0.05)


def find(sheet: Sheet, pose: NDArray[np.float64], setup: Setup, *, panel: bool, noise_m: float = 0.001) -> Registration:
    depth = with_noise(sheet.depth(CAMERA, pose, panel=panel), noise_m, 0.02)
    return register(depth, CAMERA, setup, segment_cloth(depth, CAMERA, setup))


@given(st.tuples(degrees, degrees, degrees), small, small)
@settings(max_examples=8, deadline=None, derandomize=True)
def test_a_turned_camera_is_found_before_a_panel(
    hanging: Sheet, turned: tuple[float, float, float], x: float, y: float
) -> None:
    pose = turned_pose(turned, aim=(x, y - 0.25, 0.0))
    found = find(hanging, pose, hanging.setup, panel=True)
    shift, angle = difference(found.camera_from_panel, pose)
    assert found.method == "panel_and_pins"
    assert abs(shift[2]) < 0.001
    assert np.linalg.norm(shift) < 0.015
    assert angle < 2.0


@pytest.mark.parametrize("roll", [90.0, 180.0, -90.0])
@pytest.mark.parametrize("panel", [True, False])
def test_a_camera_on_its_side_or_upside_down_is_found_by_the_pins(hanging: Sheet, roll: float, panel: bool) -> None:
    pose = turned_pose((2.0, 3.0, roll + 1.0))
    straight = replace(hanging, vertices=hanging.vertices * (1.0, 1.0, 0.0) + _swing(hanging.vertices))
    found = find(hanging if panel else straight, pose, replace(hanging.setup, panel=panel), panel=panel)
    shift, angle = difference(found.camera_from_panel, pose)
    assert np.linalg.norm(shift) < 0.015
    assert angle < 2.5
    assert any("on its side or upside down" in said for said in found.unusual)


def test_an_upright_camera_stays_so_where_pins_are_misstated(hanging: Sheet) -> None:
    pose = turned_pose((0.0, 0.0, 0.0))
    found = find(hanging, pose, hanging.setup.with_pins(top_left=(-0.24, 0.0, 0.0)), panel=True)
    assert difference(found.camera_from_panel, pose)[1] < 5.0
    assert not found.unusual


def test_pins_before_the_panel_do_not_move_it(hanging: Sheet) -> None:
    """Magnets hold the corners 12 mm off the panel: the plane that is seen stays the panel's."""
    lifted = {name: (x, y, 0.012) for name, (x, y, _) in hanging.setup.pins_m.items()}
    pose = turned_pose((2.0, 3.0, 1.0), aim=(0.0, -0.25, 0.0))
    found = find(hanging, pose, replace(hanging.setup, pins_m=lifted), panel=True)
    assert abs(difference(found.camera_from_panel, pose)[0][2]) < 0.001


def test_a_turned_camera_is_found_without_a_panel(hanging: Sheet) -> None:
    setup = make_sheet(Scene.HANGING, panel=False).setup
    vertices = hanging.vertices
    flat = replace(hanging, vertices=vertices * (1.0, 1.0, 0.0) + _swing(vertices))
    pose = turned_pose((3.0, 8.0, -2.0), distance_m=1.2)
    found = find(flat, pose, setup, panel=False)
    shift, angle = difference(found.camera_from_panel, pose)
    assert found.method == "hanging_pins"
    assert np.linalg.norm(shift) < 0.015
    assert angle < 2.5
    assert found.pin_error_m is not None
    assert found.pin_error_m < 0.01


def _swing(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """A wave in z whose mean over the sheet is zero and that is zero at the pins."""
    wave = np.zeros_like(vertices)
    wave[:, 2] = 0.03 * np.sin(2.0 * np.pi * vertices[:, 1] / 0.5) * np.cos(np.pi * vertices[:, 0] / 0.5)
    return wave


def test_a_stretched_sample_is_found_by_its_edges(stretched: Sheet) -> None:
    pose = turned_pose((1.0, 4.0, 1.5))
    found = find(stretched, pose, stretched.setup, panel=True, noise_m=0.0005)
    shift, angle = difference(found.camera_from_panel, pose)
    assert found.method == "panel_and_edges"
    assert found.pin_error_m is None
    assert np.linalg.norm(shift) < 0.015
    assert angle < 1.0


def test_the_height_map_of_a_large_sample_is_no_larger() -> None:
    """At 0.5 m a cell is 2 mm wide; what a sample of 5 m takes would else be a hundred times as much."""
    plane = Plane(np.array([0.0, 0.0, -1.0]), -0.95, 0.001, 1.0)
    depth = np.full((CAMERA.height, CAMERA.width), 0.95, np.float32)
    for size_m, cells in ((0.3, 225), (0.5, 375), (1.0, 375), (5.0, 375)):
        heights = _height_map(depth, CAMERA, plane, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.95]), size_m)
        assert heights.shape == (2 * cells + 1, 2 * cells + 1)


@pytest.mark.parametrize("size_m", [0.3, 5.0])
def test_a_sample_of_another_size_is_found_as_well(size_m: float) -> None:
    sheet, scale = make_sheet(Scene.STRETCH, size_m), size_m / 0.5
    pose = turned_pose((1.0, 4.0, 1.5), 0.95 * scale, (0.0, -0.5 * size_m, 0.0))
    shift, angle = difference(find(sheet, pose, sheet.setup, panel=True, noise_m=0.0005).camera_from_panel, pose)
    assert np.linalg.norm(shift) < 0.015 * scale
    assert angle < 1.0


def test_a_stretched_sample_without_a_panel_is_found_by_three_corners(stretched: Sheet) -> None:
    setup = make_sheet(Scene.STRETCH, panel=False).setup
    pose = turned_pose((1.0, 4.0, 1.5))
    found = find(stretched, pose, setup, panel=False, noise_m=0.0)
    shift, angle = difference(found.camera_from_panel, pose)
    assert found.method == "three_pins"
    assert np.linalg.norm(shift) < 0.012
    assert angle < 1.5


def test_a_hidden_panel_is_told(hanging: Sheet) -> None:
    found = find(hanging, turned_pose((0.0, 5.0, 0.0)), hanging.setup, panel=False)
    assert any("hidden" in said for said in found.unusual)


def test_a_setup_that_does_not_fit_is_refused(hanging: Sheet) -> None:
    setup = hanging.setup.with_pins(top_left=(-0.45, 0.0, 0.0), top_right=(0.45, 0.0, 0.0))
    with pytest.raises(InputError) as caught:
        find(hanging, turned_pose((0.0, 0.0, 0.0)), setup, panel=True)
    assert caught.value.code == "pins_not_found"


@given(
    st.lists(st.tuples(small, small, small), min_size=3, max_size=6, unique=True),
    st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    st.tuples(small, small, st.floats(0.5, 2.0)),
)
@settings(max_examples=60, deadline=None)
def test_rigid_fit_gives_a_rotation_that_is_best(
    points: list[tuple[float, float, float]], turn: tuple[float, float, float], shift: tuple[float, float, float]
) -> None:
    pose = pose_from_rotation(turn, shift)
    source = [np.asarray(p) for p in points]
    target = [pose[:3, :3] @ p + pose[:3, 3] for p in source]
    fit = rigid_fit(source, target)
    np.testing.assert_allclose(fit[:3, :3] @ fit[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(fit[:3, :3]) == pytest.approx(1.0)
    for p, q in zip(source, target, strict=True):
        np.testing.assert_allclose(fit[:3, :3] @ p + fit[:3, 3], q, atol=1e-8)


def test_pins_that_are_not_level_do_not_tilt_the_panel(hanging: Sheet) -> None:
    level = hanging.setup
    tilted = level.with_pins(top_left=(-0.2, 0.01, 0.0), top_right=(0.2, -0.01, 0.0))
    straight = replace(hanging, vertices=hanging.vertices * (1.0, 1.0, 0.0) + _swing(hanging.vertices))
    turn = np.arctan2(0.02, 0.4)
    pose = turned_pose((0.0, 0.0, 0.0))
    found = find(straight, pose, replace(level, panel=False), panel=False, noise_m=0.0)
    other = find(straight, pose, replace(tilted, panel=False), panel=False, noise_m=0.0)
    motion = invert_pose(other.camera_from_panel) @ found.camera_from_panel
    assert np.arctan2(motion[1, 0], motion[0, 0]) == pytest.approx(-turn, abs=1e-3)


def test_a_tall_sample_before_a_camera_on_its_side_is_cloth(hanging: Sheet) -> None:
    tall = replace(hanging, vertices=hanging.vertices * (0.8, 1.6, 0.8))
    setup = Setup.nominal(Scene.HANGING, sample_size_m=(0.4, 0.8), panel=False)
    pose = turned_pose((0.0, 0.0, -90.0), distance_m=1.4, aim=(0.0, -0.4, 0.0))
    depth = tall.depth(CAMERA, pose, panel=False)
    assert (segment_cloth(depth, CAMERA, setup).mask == (depth > 0.0)).mean() > 0.99


def test_edges_found_outside_of_where_they_were_looked_for_are_refused(
    stretched: Sheet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "scipy.optimize.minimize", lambda cost, first, **how: SimpleNamespace(x=first + np.array([9.0, 0.0, 0.0]))
    )
    with pytest.raises(InputError, match="add a hanging picture") as caught:
        find(stretched, turned_pose((0.0, 0.0, 0.0)), stretched.setup, panel=True)
    assert caught.value.code == "pins_not_found"


def test_the_failing_capture_is_named(make_set: MakeSet) -> None:
    def change(document: dict[str, object]) -> None:
        document["setup"] = {"pins_m": {"hanging": {"top_left": [-0.6, 0, 0], "top_right": [0.6, 0, 0]}}}

    captures = CaptureSet.load(make_set(change)).captures
    with pytest.raises(InputError, match="f1-hanging-0") as caught:
        list(prepare_all(captures[:1]))
    assert caught.value.code == "pins_not_found"


def test_the_real_capture_is_registered(shared_dir: Path) -> None:
    prepared = list(prepare_all(CaptureSet.load(shared_dir / "real" / "phisft-r1").captures))
    for one in prepared:
        pose = one.registration.camera_from_panel
        assert 4.0 < np.degrees(np.arccos(-pose[2, 2])) < 9.0
        assert one.registration.pin_error_m is not None
        assert one.registration.pin_error_m < 0.012
        assert one.network_input.length_scale == pytest.approx(1.1)
        assert np.abs(one.network_input.height).max() < 0.06


@pytest.mark.slow
def test_the_shared_cases_are_registered_as_they_were_taken(shared_dir: Path) -> None:
    captures = CaptureSet.load(shared_dir / "cases" / "open-1").captures
    unknown = [replace(capture, camera_from_panel=None) for capture in captures[:8:2]]
    for one, capture in zip(prepare_all(unknown), captures[:8:2], strict=True):
        assert capture.camera_from_panel is not None
        shift, angle = difference(one.registration.camera_from_panel, capture.camera_from_panel)
        assert np.linalg.norm(shift) < 0.005
        assert angle < 0.5
