"""`drapemeter capture`: what it prints, what it writes, what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture.capture_set import CaptureSet
from capture.picture import read_depth
from renderer.depth_png import write_depth_png
from services.cli.main import run
from tests.capture.conftest import MakeSet
from tests.capture.sheets import Sheet, camera_document, turned_pose, with_noise

Captured = pytest.CaptureFixture[str]


def document(capsys: Captured) -> dict[str, Any]:
    value: dict[str, Any] = json.loads(capsys.readouterr().out)
    return value


def test_check_tells_what_is_seen(make_set: MakeSet, capsys: Captured) -> None:
    folder = make_set()
    assert run(["capture", "check", str(folder), "--json"]) == 0
    hung, pulled = document(capsys)["captures"]
    assert hung["pose_from"] == "panel_and_pins"
    assert hung["camera_turned_deg"] == pytest.approx(5.4, abs=0.5)
    assert hung["noise_m"] == pytest.approx(0.001, rel=0.15)
    assert hung["panel"]["rms_m"] == pytest.approx(0.001, rel=0.3)
    assert 0.3 < hung["standing_share"] < 1.1
    assert hung["warnings"] == []
    assert pulled["pose"] == hung["pose"]
    assert run(["capture", "check", str(folder)]) == 0
    assert "f1-stretch-0" in capsys.readouterr().out


def test_check_warns_of_a_pose_that_the_panel_contradicts(make_set: MakeSet, capsys: Captured) -> None:
    true = turned_pose((2.0, 5.0, 1.0))

    def change(value: dict[str, Any]) -> None:
        value["setup"]["camera_from_panel"] = turned_pose((2.0, 6.5, 1.0)).tolist()

    assert run(["capture", "check", str(make_set(change, pose=true)), "--json"]) == 0
    hung = document(capsys)["captures"][0]
    assert hung["panel"]["turned_deg"] == pytest.approx(1.5, abs=0.1)
    assert any("camera_from_panel" in said for said in hung["warnings"])


def test_register_draws_every_capture(make_set: MakeSet, tmp_path: Path, capsys: Captured) -> None:
    assert run(["capture", "register", str(make_set()), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert document(capsys)["captures"][0]["id"] == "f1-hanging-0"
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "000-f1-hanging-0.png",
        "001-f1-stretch-0.png",
        "poses.json",
    ]
    poses = json.loads((tmp_path / "out" / "poses.json").read_text())
    assert np.asarray(poses["captures"][1]["pose"]).shape == (4, 4)


def test_register_takes_any_id_and_replaces_what_it_drew_before(
    make_set: MakeSet, tmp_path: Path, capsys: Captured
) -> None:
    folder, out = make_set(), tmp_path / "out"
    assert run(["capture", "register", str(folder), "--out", str(out), "--json"]) == 0
    (out / "001-own.png").write_bytes(b"somebody's")
    value = json.loads((folder / "captures.json").read_text())
    value["captures"] = [{**value["captures"][0], "id": "poly $_$ blend"}]
    (folder / "captures.json").write_text(json.dumps(value))
    assert run(["capture", "register", str(folder), "--out", str(out)]) == 0
    capsys.readouterr()
    names = sorted(path.name for path in out.iterdir())
    assert len(names) == 3 and names[1:] == ["001-own.png", "poses.json"] and "blend" in names[0]


def test_check_sees_a_hole_as_large_as_sunlight_makes_it(make_set: MakeSet, capsys: Captured) -> None:
    folder = make_set()
    camera = CaptureSet.load(folder).captures[0].camera
    path = CaptureSet.load(folder).captures[0].depth_path
    depth = read_depth(path, camera)
    rows, columns = (np.flatnonzero(outline(depth).any(axis=axis)) for axis in (1, 0))
    depth[rows[0] + len(rows) // 4 :, columns[0] : columns[-1]] = 0.0
    write_depth_png(path, depth, camera.depth_unit_m)
    assert run(["capture", "check", str(folder), "--json"]) == 0
    hung = document(capsys)["captures"][0]
    assert hung["holes"] > 0.4 and any("has no data: shade strong lights" in said for said in hung["warnings"])


def outline(depth: np.ndarray[tuple[int, int], np.dtype[np.float32]]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """About where the sample is: the middle half of the picture."""
    inside = np.zeros(depth.shape, dtype=np.bool_)
    height, width = depth.shape
    inside[height // 4 : -height // 4, width // 4 : -width // 4] = True
    return inside


def test_a_folder_of_frames_is_imported(hanging: Sheet, tmp_path: Path, capsys: Captured) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    from tests.capture.sheets import CAMERA

    still = hanging.depth(CAMERA, turned_pose((0.0, 3.0, 0.0)))
    for number in range(3):
        write_depth_png(frames / f"{number}.png", with_noise(still, 0.001, 0.05, seed=number))
    (tmp_path / "camera.json").write_text(json.dumps(camera_document()))
    arguments = [
        "capture",
        "import",
        str(frames),
        "--fabric",
        "wool",
        "--scene",
        "hanging",
        "--out",
        str(tmp_path / "s"),
    ]
    assert run([*arguments, "--json"]) == 2
    assert "camera_needed" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()
    assert run([*arguments, "--camera", str(tmp_path / "camera.json"), "--density", "0.3", "--json"]) == 0
    assert document(capsys)["capture"] == "wool-hanging-0"
    assert run(["capture", "check", str(tmp_path / "s"), "--json"]) == 0
    assert document(capsys)["fabrics"] == [{"id": "wool", "density": 0.3, "parameters_given": False}]


def test_a_recording_brings_its_own_camera(tmp_path: Path, capsys: Captured) -> None:
    """Before the driver is asked for: the recording need not be one."""
    (tmp_path / "camera.json").write_text(json.dumps(camera_document()))
    for name in ("still.bag", "still.db3"):
        (tmp_path / name).touch()
        said = ["--camera", str(tmp_path / "camera.json"), "--fabric", "a", "--scene", "hanging"]
        assert run(["capture", "import", str(tmp_path / name), *said, "--out", str(tmp_path / "set"), "--json"]) == 2
        captured = capsys.readouterr()
        assert captured.out == "" and captured.err.count("\n") == 1
        assert f"{name} is a recording" in captured.err and captured.err.endswith("[camera_not_needed]\n")
    assert not (tmp_path / "set").exists()


def test_the_schema_is_one_document(capsys: Captured) -> None:
    assert run(["capture", "schema"]) == 0
    assert document(capsys)["title"] == "drape-capture-set/1"


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["check", "nowhere"], "capture_set_missing"),
        (["check", "."], "captures_json_missing"),
        (["register", "nowhere", "--out", "x"], "capture_set_missing"),
        (["import", "nowhere", "--fabric", "a", "--scene", "draping", "--out", "x"], "scene_unknown"),
        (["import", ".", "--fabric", "a", "--scene", "hanging", "--out", "x"], "camera_needed"),
        (["import", "a", "--fabric", "a", "--scene", "hanging", "--sample-size", "90", "--out", "x"], "sample_size"),
        (
            ["import", __file__, "--fabric", "a", "--scene", "hanging", "--camera", "c", "--out", "x"],
            "recording_unusable",
        ),
        (["check"], "usage"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["capture", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert f"[{code}]" in captured.err
    assert not list(tmp_path.iterdir())
