"""What captures of one camera say of its pose together."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from capture.camera_rig import AT_ODDS, ELSEWHERE, MAX_SHIFT_M, NO_POSE, SHIFTED, common_pose, share_pose
from capture.capture_set import CaptureSet
from capture.plane import Plane
from capture.prepare import _same_camera, prepare, prepare_all
from capture.register import Registration, given_registration
from capture.report import BY_EDGES_ALONE, report_capture
from renderer.depth_png import read_depth_png, write_depth_png
from renderer.pose import pose_from_rotation
from simcore.errors import InputError
from simcore.scenes import Scene
from tests.capture.conftest import MakeSet
from tests.capture.sheets import CAMERA, Sheet, difference, turned_pose, with_noise


def registration(pose: NDArray[np.float64]) -> Registration:
    return replace(given_registration(pose), method="panel_and_pins", assumed=())


def panel_of(pose: NDArray[np.float64]) -> Plane:
    """The panel as a camera there sees it."""
    return Plane(pose[:3, 2], float(pose[:3, 2] @ pose[:3, 3]), 0.001, 0.8)


def test_poses_of_one_camera_are_put_together_and_a_stray_one_is_left_out() -> None:
    true = turned_pose((1.0, 2.0, 0.0))
    rng = np.random.default_rng(0)
    poses = []
    for _ in range(5):
        pose = true @ pose_from_rotation(rng.normal(0, 0.003, 3), rng.normal(0, 0.002, 3))
        poses.append(pose)
    poses.append(true @ pose_from_rotation((0.0, 0.0, 0.3), (0.1, 0.0, 0.0)))
    common = common_pose(poses)
    assert common is not None
    shift, angle = difference(common, true)
    assert np.linalg.norm(shift) < 0.004
    assert angle < 0.3
    assert common_pose([true, turned_pose((0.0, 0.0, 0.0), distance_m=1.4)]) is None


def test_hanging_pictures_give_the_pose_of_stretched_ones() -> None:
    true = turned_pose((1.0, 2.0, 0.0))

    def never() -> Registration:
        raise AssertionError("not needed")

    def fails() -> Registration:
        raise InputError("no edges", code="pins_not_found")

    scenes = [Scene.STRETCH, Scene.HANGING, Scene.STRETCH, Scene.STRETCH]
    planes = [panel_of(true), panel_of(true), None, panel_of(true)]  # one is hidden
    shared = share_pose(scenes, [lambda: registration(true), lambda: registration(true), never, fails], planes)
    assert len(shared) == 4
    for one in shared:
        np.testing.assert_allclose(one.camera_from_panel, true, atol=1e-9)
        assert "1 gave its pose" in one.assumed[-1] and not one.unusual


def test_a_moved_camera_keeps_its_poses_and_failures_are_raised() -> None:
    a, b = turned_pose((0.0, 0.0, 0.0)), turned_pose((0.0, 9.0, 0.0), distance_m=1.2)
    kept = share_pose([Scene.HANGING] * 2, [lambda: registration(a), lambda: registration(b)], [None] * 2)
    np.testing.assert_array_equal(kept[1].camera_from_panel, b)
    assert kept[1].unusual == (AT_ODDS,)

    def fails() -> Registration:
        raise InputError("no corners", code="pins_not_found")

    with pytest.raises(InputError, match="no corners"):
        share_pose([Scene.HANGING], [fails], [None])
    still = [lambda: registration(a)] * 2
    given = share_pose([Scene.HANGING] * 3, [*still, fails], [panel_of(a)] * 3)[2]
    np.testing.assert_allclose(given.camera_from_panel, a, atol=1e-9)
    assert given.unusual == (NO_POSE,)
    with pytest.raises(InputError, match="no corners"):  # what its panel says against the others' pose counts
        share_pose([Scene.HANGING] * 3, [*still, fails], [panel_of(a), panel_of(a), panel_of(b)])


@pytest.mark.parametrize("elsewhere", [((1.0, 2.0, 0.0), 1.01), ((1.0, 5.0, 0.0), 0.95)])
def test_a_stretched_picture_whose_panel_lies_elsewhere_is_registered_by_itself(
    elsewhere: tuple[tuple[float, float, float], float],
) -> None:
    still, moved = turned_pose((1.0, 2.0, 0.0)), turned_pose(*elsewhere)
    alone = [lambda: registration(still)] * 2 + [lambda: registration(moved)] * 2
    planes = [panel_of(still), panel_of(still), panel_of(moved), panel_of(still)]
    shared = share_pose([Scene.HANGING] * 2 + [Scene.STRETCH] * 2, alone, planes)
    np.testing.assert_array_equal(shared[2].camera_from_panel, moved)
    np.testing.assert_allclose(shared[3].camera_from_panel, still, atol=1e-9)
    assert [one.unusual for one in shared] == [(), (), (ELSEWHERE,), ()]
    assert "still over 3 captures" in shared[3].assumed[-1]


def shifted(pose: NDArray[np.float64], right_m: float, up_m: float) -> NDArray[np.float64]:
    """The pose of a camera that was moved along the panel."""
    moved = pose.copy()
    moved[:3, 3] += right_m * pose[:3, 0] + up_m * pose[:3, 1]
    return moved


@pytest.mark.parametrize(("share", "noted"), [(0.9, False), (1.1, True)])
def test_a_stretched_picture_whose_edges_lie_elsewhere_on_the_panel_is_noted(share: float, noted: bool) -> None:
    still = turned_pose((1.0, 2.0, 0.0))
    moved = shifted(still, 0.6 * share * MAX_SHIFT_M, -0.8 * share * MAX_SHIFT_M)
    alone = [lambda: registration(still)] * 2 + [lambda: registration(moved)]
    _, _, pulled = share_pose([Scene.HANGING] * 2 + [Scene.STRETCH], alone, [panel_of(still)] * 3)
    np.testing.assert_allclose(pulled.camera_from_panel, moved if noted else still, atol=1e-9)
    assert pulled.unusual == ((SHIFTED,) if noted else ())


def test_stretched_pictures_alone_are_not_held_against_each_others_edges() -> None:
    """Theirs are too uncertain for that: the pose is that of most."""
    still = turned_pose((1.0, 2.0, 0.0))
    poses = [still, still, still, shifted(still, 0.06, 0.0)]
    shared = share_pose([Scene.STRETCH] * 4, [lambda p=p: registration(p) for p in poses], [panel_of(still)] * 4)
    assert all(one.unusual == () for one in shared)
    np.testing.assert_allclose(shared[3].camera_from_panel, still, atol=1e-9)


def test_a_capture_from_elsewhere_keeps_its_own_pose_where_that_fits_its_pins() -> None:
    still, moved = turned_pose((1.0, 2.0, 0.0)), turned_pose((1.0, 2.0, 0.0), aim=(0.1, -0.25, 0.0))
    for error_m, kept in ((0.004, moved), (0.05, still)):  # its pins found, or badly
        votes = [replace(registration(pose), pin_error_m=e) for pose, e in ((still, 0.004),) * 2 + ((moved, error_m),)]
        alone = [lambda v=v: v for v in [*votes, votes[0]]]
        shared = share_pose([Scene.HANGING] * 3 + [Scene.STRETCH], alone, [None] * 4)
        for one, expected in zip(shared, (still, still, kept, still), strict=True):
            np.testing.assert_allclose(one.camera_from_panel, expected, atol=1e-9)
        assert "2 gave its pose" in shared[0].assumed[-1]
        assert (ELSEWHERE in shared[2].unusual) is (kept is moved)


def test_a_set_without_a_pose_is_prepared(make_set: MakeSet) -> None:
    true = turned_pose((2.0, 5.0, 1.0))
    captures = CaptureSet.load(make_set()).captures
    hung, pulled = prepare_all(captures)
    for one in (hung, pulled):
        shift, angle = difference(one.registration.camera_from_panel, true)
        assert np.linalg.norm(shift) < 0.01
        assert angle < 1.5
        assert one.network_input.height.shape == (256, 256)
    assert 0.09 < hung.network_input.height.max() < 0.14
    alone = prepare(captures[1])
    assert alone.registration.method == "panel_and_edges"


def test_a_camera_that_was_moved_between_the_scenes_is_found_twice(make_set: MakeSet, stretched: Sheet) -> None:
    """Not 60 mm off in depth, as where the hanging picture alone were heard."""
    folder, moved = make_set(), turned_pose((2.0, 5.0, 1.0), distance_m=1.01)
    write_depth_png(folder / "f1-stretch-0.png", with_noise(stretched.depth(CAMERA, moved), 0.001, 0.01))
    hung, pulled = prepare_all(CaptureSet.load(folder).captures)
    assert difference(hung.registration.camera_from_panel, turned_pose((2.0, 5.0, 1.0)))[0][2] < 0.001
    shift, angle = difference(pulled.registration.camera_from_panel, moved)
    assert abs(shift[2]) < 0.001 and np.linalg.norm(shift) < 0.015
    assert angle < 1.0
    assert pulled.registration.unusual == (ELSEWHERE,)
    assert ELSEWHERE in report_capture(pulled).warnings


def test_a_camera_that_was_moved_along_the_panel_between_the_scenes_is_noted(
    make_set: MakeSet, stretched: Sheet
) -> None:
    """Its distance and direction are the same: the panel says nothing of it."""
    folder, moved = make_set(), turned_pose((2.0, 5.0, 1.0), aim=(0.08, -0.25, 0.0))
    write_depth_png(folder / "f1-stretch-0.png", with_noise(stretched.depth(CAMERA, moved), 0.001, 0.01))
    hung, pulled = prepare_all(CaptureSet.load(folder).captures)
    assert not hung.registration.unusual and pulled.registration.unusual == (SHIFTED,)
    assert np.linalg.norm(difference(pulled.registration.camera_from_panel, moved)[0]) < 0.015
    warnings = report_capture(pulled).warnings
    assert SHIFTED in warnings and BY_EDGES_ALONE not in warnings


def test_samples_of_another_size_hang_elsewhere(make_set: MakeSet) -> None:
    def change(document: dict[str, Any]) -> None:
        document["captures"][1]["setup"] = {"sample_size_m": [0.3, 0.3]}

    assert _same_camera(CaptureSet.load(make_set(change)).captures) == [[0], [1]]


@pytest.mark.slow
@pytest.mark.parametrize("moved_px", [0, 60])
def test_a_camera_moved_along_the_panel_is_noted_on_the_shared_cases(
    shared_dir: Path, tmp_path: Path, moved_px: int
) -> None:
    """The fourth open set's camera is turned: its panel, too, lies where it lay, whatever is moved along it."""
    case = shared_dir / "cases" / "open-4"
    document = json.loads((case / "captures.json").read_text())
    document["setup"]["camera_from_panel"] = None
    first = {"f1-hanging-0", "f1-stretch-0", "f2-hanging-0", "f2-stretch-0"}
    document["captures"] = [capture for capture in document["captures"] if capture["id"] in first]
    (tmp_path / "captures.json").write_text(json.dumps(document))
    for capture in document["captures"]:
        depth = read_depth_png(case / capture["depth"])
        away = moved_px if capture["scene"] == "stretch" else 0
        columns = np.clip(np.arange(depth.shape[1]) - away, 0, depth.shape[1] - 1)
        write_depth_png(tmp_path / capture["depth"], depth[:, columns])
    prepared = list(prepare_all(CaptureSet.load(tmp_path).captures))
    noted = [one.capture.scene for one in prepared if SHIFTED in one.registration.unusual]
    assert noted == ([Scene.STRETCH] * 2 if moved_px else [])
