"""Capture sets on disk: reading, checking, writing."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from capture.capture_set import CaptureSet, new_document, picture_path, write_captures_json
from capture.documents import SetupDocument
from capture.setup import passed_over, setup_from_document
from renderer.pose import pose_from_rotation
from simcore.errors import InputError
from simcore.scenes import Scene, Setup
from tests.capture.conftest import MakeSet
from tests.capture.sheets import CAMERA, camera_document, turned_pose

Change = Callable[[dict[str, Any]], None]


def set_key(path: str, value: Any) -> Change:
    def change(document: dict[str, Any]) -> None:
        *way, last = path.split("/")
        place: Any = document
        for step in way:
            place = place[int(step)] if step.isdigit() else place.setdefault(step, {})
        place[last] = value

    return change


def test_a_set_is_read(make_set: MakeSet) -> None:
    found = CaptureSet.load(make_set())
    assert [c.id for c in found.captures] == ["f1-hanging-0", "f1-stretch-0"]
    hanging, stretch = found.captures
    assert hanging.camera == CAMERA
    assert hanging.setup == Setup.nominal("hanging")
    assert stretch.scene is Scene.STRETCH
    assert stretch.pins_from == "nominal"
    assert hanging.camera_from_panel is None
    depth = hanging.read_depth()
    assert depth.dtype == np.float32
    assert depth.shape == (240, 320)
    assert 0.7 < np.median(depth) < 1.1
    assert (depth == 0.0).mean() == pytest.approx(0.01, abs=0.005)
    assert found.of_fabric("f1") == found.captures
    assert found.of_fabric("other") == ()


def test_a_picture_may_lie_deep_in_folders(make_set: MakeSet) -> None:
    deep = "/".join(["measured with the second camera"] * 8) + "/f1.png"
    folder = make_set(set_key("captures/0/depth", deep))
    assert len(deep) > 200
    path = folder / deep
    path.parent.mkdir(parents=True)
    (folder / "f1-hanging-0.png").rename(path)
    assert CaptureSet.load(folder).captures[0].read_depth().shape == (240, 320)


def test_a_captures_own_camera_and_setup_go_first(make_set: MakeSet) -> None:
    def change(document: dict[str, Any]) -> None:
        document["setup"]["pin_radius_m"] = 0.0
        document["captures"][1]["camera"] = {**camera_document(), "fx": 240.0}
        document["captures"][1]["setup"] = {"camera_from_panel": turned_pose((0, 0, 0)).tolist(), "panel": False}

    first, second = CaptureSet.load(make_set(change)).captures
    assert (first.camera.fx, second.camera.fx) == (237.5, 240.0)
    assert (first.setup.panel, second.setup.panel) == (True, False)
    assert second.setup.pin_radius_m == 0.0
    assert first.camera_from_panel is None
    np.testing.assert_allclose(second.camera_from_panel, turned_pose((0, 0, 0)))


def test_pins_come_from_the_set_or_the_pin_distance_or_the_nominal_setup(make_set: MakeSet) -> None:
    given = {"top_left": [-0.19, 0, 0], "top_right": [0.2, 0, 0]}

    def change(document: dict[str, Any]) -> None:
        document["setup"]["sample_size_m"] = [0.4, 0.4]
        document["setup"]["pins_m"] = {"hanging": given}
        document["captures"].append({**document["captures"][1], "id": "y", "setup": {"pins_m": {"stretch": {}}}})

    found = CaptureSet.load
    folder = make_set(change)
    with pytest.raises(InputError, match="needs pins") as caught:
        _ = found(folder, read_pictures=False).captures
    assert caught.value.code == "pins_missing"
    document = json.loads((folder / "captures.json").read_text())
    document["captures"].pop()
    (folder / "captures.json").write_text(json.dumps(document))
    hanging, stretch = found(folder).captures
    assert hanging.pins_from == "given"
    assert hanging.setup.pins_m["top_left"] == (-0.19, 0.0, 0.0)
    assert stretch.pins_from == "nominal"
    assert stretch.setup == Setup.nominal("stretch", sample_size_m=(0.4, 0.4))
    del document["setup"]["pins_m"]
    document["setup"]["pin_distance_m"] = 0.3
    (folder / "captures.json").write_text(json.dumps(document))
    hanging, stretch = found(folder).captures
    assert hanging.pins_from == "pin_distance"
    assert hanging.setup.pins_m == {"top_left": (-0.15, 0.0, 0.0), "top_right": (0.15, 0.0, 0.0)}
    assert stretch.pins_from == "nominal"


def test_a_set_is_saved_whole_with_what_it_does_not_know(make_set: MakeSet, tmp_path: Path) -> None:
    folder = make_set(set_key("camera/model", "kept"))
    before = json.loads((folder / "captures.json").read_text())
    found = CaptureSet.load(folder)
    assert json.loads(found.save(tmp_path / "copy").read_text()) == before
    assert found.save() == folder / "captures.json"
    assert json.loads((folder / "captures.json").read_text()) == before
    assert not list(folder.glob(".*"))


def test_a_document_can_be_put_together_by_other_programs(tmp_path: Path) -> None:
    document = new_document(
        name="made",
        camera=CAMERA,
        fabrics=[{"id": "a", "density": 0.1}],
        captures=[{"id": "a-0", "fabric": "a", "scene": "stretch", "depth": "a.png"}],
        setup={"panel": False},
        sensor={"range_noise_m": 0.001},
    )
    write_captures_json(document, tmp_path)
    capture = CaptureSet.load(tmp_path, read_pictures=False).captures[0]
    assert capture.sensor is not None
    assert capture.sensor.range_noise_m == 0.001
    assert capture.repeat == 0


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:2000])


def eight_bit(path: Path) -> None:
    Image.new("L", (320, 240), 9).save(path)


def colour(path: Path) -> None:
    Image.new("RGB", (320, 240), (9, 9, 9)).save(path)


def small(path: Path) -> None:
    Image.fromarray(np.full((24, 32), 9000, np.uint16)).save(path)


def empty(path: Path) -> None:
    Image.fromarray(np.zeros((240, 320), np.uint16)).save(path)


def text(path: Path) -> None:
    path.write_text("not a picture")


@pytest.mark.parametrize(
    ("damage", "code"),
    [
        (Path.unlink, "depth_missing"),
        (truncate, "depth_damaged"),
        (eight_bit, "depth_not_16_bit"),
        (colour, "depth_not_16_bit"),
        (small, "depth_wrong_size"),
        (empty, "depth_empty"),
        (text, "depth_not_png"),
    ],
)
def test_a_bad_picture_is_found_when_the_set_is_loaded(
    make_set: MakeSet, damage: Callable[[Path], None], code: str
) -> None:
    folder = make_set()
    damage(folder / "f1-stretch-0.png")
    with pytest.raises(InputError) as caught:
        CaptureSet.load(folder)
    assert caught.value.code == code
    assert "f1-stretch-0.png" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (set_key("captures/0/depth", "../f1-hanging-0.png"), "path_outside_set"),
        (set_key("captures/0/depth", "/etc/hostname"), "path_outside_set"),
        (set_key("captures/0/depth", "a\0b"), "path_outside_set"),
        (set_key("captures/0/depth", "itself.png"), "path_outside_set"),
        (set_key("setup/camera_from_panel", [[1.0, 0, 0, 0]] * 4), "pose"),
        (set_key("setup/sample_size_m", [50.0, 50.0]), "sample_size"),
        (set_key("setup/pin_radius_m", 0.4), "pin_radius"),
        (set_key("setup/pin_distance_m", -1), "pin_distance"),
        (set_key("camera/width", 100_000), "capture_set_invalid"),
    ],
)
def test_bad_values_are_refused_and_say_which_capture(make_set: MakeSet, change: Change, code: str) -> None:
    folder = make_set(change)
    (folder / "itself.png").symlink_to("itself.png")
    with pytest.raises(InputError) as caught:
        CaptureSet.load(folder)
    assert caught.value.code == code
    assert "captures.json" in str(caught.value)


def test_a_set_named_by_a_dot_holds_its_pictures_too(make_set: MakeSet, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_set(set_key("captures/0/depth", "../f1-hanging-0.png"))
    (folder / "f1-hanging-0.png").rename(folder.parent / "f1-hanging-0.png")
    monkeypatch.chdir(folder)
    with pytest.raises(InputError) as caught:
        CaptureSet.load(Path())
    assert caught.value.code == "path_outside_set"


def test_a_picture_that_is_read_may_be_a_link_and_none_is_written_through_one(make_set: MakeSet) -> None:
    folder = make_set(set_key("captures/0/depth", "link.png"))
    (folder / "f1-hanging-0.png").rename(folder.parent / "outside.png")
    (folder / "link.png").symlink_to(folder.parent / "outside.png")
    first = CaptureSet.load(folder).captures[0]
    assert first.read_depth().max() > 0.0
    with pytest.raises(InputError) as caught:
        picture_path(folder, "link.png", writing=True)
    assert caught.value.code == "path_outside_set"


def test_a_pose_with_few_digits_is_the_nearest_rotation(make_set: MakeSet) -> None:
    exact = pose_from_rotation((3.05, 0.11, -0.07), (0.01, -0.25, 0.9))
    rounded = np.round(exact, 3)
    folder = make_set(set_key("setup/camera_from_panel", rounded.tolist()))
    found = CaptureSet.load(folder).captures[0]
    pose = found.camera_from_panel
    assert pose is not None
    assert np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() < 1e-12
    assert np.abs(pose - exact).max() < 1e-3
    same = np.round(exact, 9).tolist()  # enough digits: as it is stated
    document = json.loads((folder / "captures.json").read_text())
    document["setup"]["camera_from_panel"] = same
    (folder / "captures.json").write_text(json.dumps(document))
    found = CaptureSet.load(folder).captures[0]
    assert found.camera_from_panel is not None and found.camera_from_panel.tolist() == same


def test_pins_by_corner_on_the_panel_and_no_others(make_set: MakeSet) -> None:
    """A capture moves one pin of those that the set states; what a scene has not is passed over."""
    pins = {"top_left": [-0.2, 0, -1e-17], "top_right": [0.2, 0, -3e-4], "bottom_right": [0.2, -0.5, 0]}

    def change(document: dict[str, Any]) -> None:
        document["setup"]["pins_m"] = {"hanging": pins}
        document["captures"][0]["setup"] = {"pins_m": {"hanging": {"top_left": [-0.21, 0, 0]}}}

    hanging = CaptureSet.load(make_set(change)).captures[0]
    assert hanging.setup.pins_m == {"top_left": (-0.21, 0.0, 0.0), "top_right": (0.2, 0.0, 0.0)}
    document = SetupDocument(pins_m={"hanging": {name: tuple(place) for name, place in pins.items()}})
    assert passed_over(Scene.HANGING, document) == ["bottom_right"]
    assert setup_from_document(Scene.HANGING, document).pins_m["top_left"][2] == 0.0
    bare = document.overridden_by(SetupDocument(panel=False))
    assert setup_from_document(Scene.HANGING, bare).pins_m["top_right"][2] == -3e-4


def test_what_is_no_set_is_said_so(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        CaptureSet.load(tmp_path / "nowhere")
    assert caught.value.code == "capture_set_missing"
    with pytest.raises(InputError) as caught:
        CaptureSet.load(tmp_path)
    assert caught.value.code == "captures_json_missing"
    (tmp_path / "captures.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError) as caught:
        CaptureSet.load(tmp_path)
    assert caught.value.code == "file_unreadable"


def test_the_shared_sets_are_read(shared_dir: Path) -> None:
    for folder in (*sorted((shared_dir / "cases").glob("open-?")), shared_dir / "real" / "phisft-r1"):
        found = CaptureSet.load(folder, read_pictures=False)
        assert found.captures
        assert found.document.as_json() == json.loads((folder / "captures.json").read_text())
