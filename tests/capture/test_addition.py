"""Adding to a set: what it says otherwise is refused or kept with the capture, and nobody's capture is lost."""

from __future__ import annotations

import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture.addition import LOCK_FILE, NewCapture
from capture.capture_set import CaptureSet
from capture.record import check_capture, record_capture
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from simcore.errors import InputError
from simcore.parameters import ESTIMATED_NAMES
from simcore.scenes import Setup
from tests.capture.flat import Flat, add
from tests.capture.set_document import change, document

PARAMETERS = dict.fromkeys(ESTIMATED_NAMES[:3], 500.0) | dict.fromkeys(ESTIMATED_NAMES[3:], 1e-4)


@pytest.mark.parametrize(
    ("said", "word"),
    [
        ({"density": 0.25}, "density is 0.2 there and 0.25 here"),
        ({"density": 0.2, "parameters": {**PARAMETERS, "bending_bias": 2e-4}}, "bending_bias is 0.0001 there"),
    ],
)
def test_a_fabric_with_other_numbers_is_refused(tmp_path: Path, said: dict[str, Any], word: str) -> None:
    folder = tmp_path / "set"
    add(folder, density=0.2, parameters=PARAMETERS)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(InputError, match=word) as caught:
        add(folder, **said)
    assert caught.value.code == "fabric_differs"
    assert "'f1'" in str(caught.value) and "--fabric" in str(caught.value)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    add(folder, density=0.2 + 1e-9, parameters=PARAMETERS)  # the same number
    add(folder)  # nothing said
    add(folder, "f2", **said)  # another name
    assert [fabric["id"] for fabric in document(folder)["fabrics"]] == ["f1", "f2"]


def test_numbers_that_the_set_does_not_state_are_refused(tmp_path: Path) -> None:
    add(tmp_path / "set")
    with pytest.raises(InputError, match="density is not stated there"):
        add(tmp_path / "set", density=0.2)


def test_a_picture_that_the_set_no_longer_names_is_not_overwritten(tmp_path: Path) -> None:
    """Somebody took its entry out and kept the file; a run that was interrupted leaves one, too."""
    folder = tmp_path / "set"
    for _ in range(2):
        add(folder)
    left, other = (folder / capture["depth"] for capture in document(folder)["captures"])
    change(folder, captures=document(folder)["captures"][1:])
    before = left.read_bytes()
    add(folder)
    assert left.read_bytes() == before
    assert {folder / capture["depth"] for capture in document(folder)["captures"]} - {other} != {left}


def test_another_setup_is_kept_with_its_capture(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    pose = frontal_pose()
    pins = {scene: Setup.nominal(scene).pins_m for scene in ("hanging", "stretch")}

    def said(scene: str) -> dict[str, Any]:
        own = {"sample_size_m": [0.5, 0.5], "panel": True, "pin_radius_m": 0.01, "camera_from_panel": pose.tolist()}
        return {**own, "pins_m": {scene: pins[scene]}}

    for scene in ("hanging", "stretch"):
        add(folder, scene=scene, setup=said(scene))
    assert all("setup" not in capture for capture in document(folder)["captures"])

    moved = {"top_left": [-0.19, 0.0, 0.0], "top_right": [0.2, 0.0, 0.0]}
    other = {"sample_size_m": [0.4, 0.5], "panel": False, "pin_radius_m": 0.0, "pins_m": {"hanging": moved}}
    change(folder, setup={**other, "camera_from_panel": None})
    add(folder, setup=said("hanging"))
    add(folder, scene="stretch", setup={"panel": False, "sample_size_m": [0.4, 0.5]})
    captures = CaptureSet.load(folder).captures
    assert captures[2].setup == Setup.nominal("hanging")
    assert captures[2].camera_from_panel is not None
    np.testing.assert_allclose(captures[2].camera_from_panel, pose)
    assert captures[0].setup.pins_m["top_left"] == (-0.19, 0.0, 0.0)  # the set still says what it said
    assert "setup" not in document(folder)["captures"][3]
    change(folder, setup={"pin_distance_m": 0.36})
    add(folder, setup=said("hanging"))
    assert document(folder)["captures"][4]["setup"].keys() == {"camera_from_panel", "pins_m"}


def test_another_camera_does_not_stand_where_the_sets_did(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    add(folder, setup={"camera_from_panel": frontal_pose().tolist()}, sensor={"range_noise_m": 0.001})
    other = Flat(camera=replace(CANONICAL_CAMERA, fx=600.0, fy=600.0))
    told: list[str] = []
    record_capture(other, folder, NewCapture("f1", "hanging"), frames=1, tell=told.append)
    assert CaptureSet.load(folder).captures[1].camera_from_panel is None
    assert len(told) == 2 and "will be found in its picture" in told[0] and "the set's sensor counts" in told[1]
    stated = {"camera_from_panel": frontal_pose(1.2).tolist()}
    record_capture(other, folder, NewCapture("f1", "hanging", setup=stated), frames=1)
    record_capture(Flat(), folder, NewCapture("f1", "hanging"), frames=1, tell=told.append)
    captures = CaptureSet.load(folder).captures
    assert captures[2].camera_from_panel is not None and captures[2].camera_from_panel[2, 3] == pytest.approx(1.2)
    assert "setup" not in document(folder)["captures"][3] and len(told) == 2


@pytest.mark.parametrize("scene", ["hanging", "stretch"])
def test_a_sample_of_another_size_is_not_pinned_as_the_sets(tmp_path: Path, scene: str) -> None:
    folder = tmp_path / "set"
    wide = Setup.nominal(scene)
    moved = {**wide.pins_m, "top_left": (-0.19, 0.0, 0.0)}
    add(folder, scene=scene, setup={"pins_m": {scene: moved}})
    told: list[str] = []
    small = NewCapture("f2", scene, setup={"sample_size_m": [0.4, 0.4]})
    record_capture(Flat(), folder, small, frames=1, tell=told.append)
    record_capture(Flat(), folder, NewCapture("f2", scene, setup={"sample_size_m": [0.5, 0.5]}), frames=1)
    captures = CaptureSet.load(folder).captures
    assert captures[1].setup == Setup.nominal(scene, sample_size_m=(0.4, 0.4))
    assert len(told) == 1 and "nominal ones of that size" in told[0]
    assert captures[2].setup.pins_m["top_left"] == (-0.19, 0.0, 0.0)


def test_a_setup_that_cannot_be_is_refused_before_there_is_a_picture(tmp_path: Path) -> None:
    add(tmp_path / "set")
    with pytest.raises(InputError) as caught:
        check_capture(tmp_path / "set", NewCapture("f1", "hanging", setup={"pin_radius_m": 0.3}), CANONICAL_CAMERA)
    assert caught.value.code == "pin_radius"


def test_a_set_has_one_sensor(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    ideal = {"range_noise_m": 0.0, "at_m": 0.9, "quantisation_m": 1e-4}
    add(folder, sensor=ideal)
    assert document(folder)["sensor"] == ideal
    for sensor in ({"range_noise_m": 0.001, "at_m": 0.9}, {"quantisation_m": 2e-4}):
        change(folder, sensor=sensor)
        with pytest.raises(InputError) as caught:
            add(folder, sensor=ideal)
        assert caught.value.code == "sensor_differs"
    for silent in ({}, {"range_noise_m": None}, {"range_noise_m": 0.0, "quantisation_m": 0.0}):
        change(folder, sensor=silent)
        add(folder, sensor=ideal)
        assert document(folder)["sensor"] == silent


@pytest.mark.parametrize("fabric", ["../silk", "denim 12/3 (blue)", "a" * 200, "織" * 150, ".", "Stoff: Köper\n"])
def test_a_fabric_may_have_any_id(tmp_path: Path, fabric: str) -> None:
    folder = tmp_path / "deep" / "set"
    names = {add(folder, fabric, scene) for scene in ("hanging", "hanging", "stretch")}
    found = CaptureSet.load(folder)
    assert {capture.fabric.id for capture in found.captures} == {fabric}
    assert len(names) == len({capture.depth_path for capture in found.captures}) == 3
    assert all(capture.depth_path.parent == folder for capture in found.captures)
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["set"]


def test_ids_that_name_the_same_file_get_pictures_of_their_own(tmp_path: Path) -> None:
    for fabric in ("a/b", "a:b", "a_b", "x" * 160 + "1", "x" * 160 + "2"):
        add(tmp_path / "set", fabric)
    captures = CaptureSet.load(tmp_path / "set").captures
    assert len({capture.depth_path for capture in captures}) == len({capture.id for capture in captures}) == 5


@pytest.mark.parametrize("fabric", ["", "x" * 201])
def test_an_id_that_the_format_does_not_take(tmp_path: Path, fabric: str) -> None:
    with pytest.raises(InputError) as caught:
        check_capture(tmp_path / "set", NewCapture(fabric, "hanging"), CANONICAL_CAMERA)
    assert caught.value.code == "fabric_name"
    assert not list(tmp_path.iterdir())


def test_threads_that_add_at_once_lose_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import time

    import capture.record

    write = capture.record.write_captures_json

    def slowly(*arguments: Any) -> None:
        time.sleep(0.05)  # between reading and writing
        write(*arguments)

    monkeypatch.setattr(capture.record, "write_captures_json", slowly)
    threads = [threading.Thread(target=add, args=(tmp_path / "set", f"f{number % 2}")) for number in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    found = CaptureSet.load(tmp_path / "set")
    assert len(found.captures) == 6
    assert sorted((c.fabric.id, c.repeat) for c in found.captures) == [(f, n) for f in ("f0", "f1") for n in range(3)]


def test_a_set_in_the_making_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import capture.record

    write, folder = capture.record.write_captures_json, tmp_path / "set"
    begun, go_on = threading.Event(), threading.Event()

    def late(*arguments: Any) -> None:
        begun.set()  # the first picture is there
        go_on.wait(10.0)
        write(*arguments)

    monkeypatch.setattr(capture.record, "write_captures_json", late)
    threads = [threading.Thread(target=add, args=(folder, "f0"))]
    threads[0].start()
    assert begun.wait(10.0)
    threads.append(threading.Thread(target=add, args=(folder, "f1")))
    threads[1].start()
    threads[1].join(0.2)
    go_on.set()
    for thread in threads:
        thread.join()
    assert [capture.fabric.id for capture in CaptureSet.load(folder).captures] == ["f0", "f1"]


def test_another_process_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "set"
    add(folder)
    program = (
        "import sys\nfrom filelock import FileLock\n"
        "with FileLock(sys.argv[1]):\n    print('held', flush=True)\n    sys.stdin.read()\n"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", program, str(folder / LOCK_FILE)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert other.stdout is not None and other.stdout.readline() == b"held\n"
        monkeypatch.setattr("capture.record.LOCK_WAIT_S", 0.1)
        with pytest.raises(InputError) as caught:
            add(folder)
        assert caught.value.code == "set_busy"
        assert len(CaptureSet.load(folder).captures) == 1  # a reader is not kept waiting
    finally:
        other.communicate()
    assert add(folder) == "f1-hanging-1"
