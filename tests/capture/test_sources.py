"""Depth sources and recording, replayed from a stand-in camera that only these tests know."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from numpy.typing import NDArray

from capture.addition import LOCK_FILE, NewCapture
from capture.capture_set import CaptureSet
from capture.realsense import RealSenseSource, camera_from_intrinsics, import_realsense
from capture.record import moving, record_capture, temporal_median
from capture.sources import DepthSource, Frame, PngFolderSource, load_camera
from renderer.camera import Camera
from renderer.depth_png import quantise_depth, write_depth_png
from simcore.errors import InputError, MissingResourceError
from tests.capture.sheets import CAMERA, Sheet, camera_document, turned_pose, with_noise


class StandInCamera(DepthSource):
    """A test's camera: a still scene with noise and holes that differ from frame to frame, without an end."""

    def __init__(self, still: NDArray[np.float32], camera: Camera = CAMERA) -> None:
        self.still = still
        self.given = 0
        self.closed = False
        self._camera = camera

    @property
    def camera(self) -> Camera:
        return self._camera

    def frames(self) -> Iterator[Frame]:
        while True:
            noisy = with_noise(self.still, 0.003, 0.2, seed=self.given)
            self.given += 1
            yield quantise_depth(noisy, self._camera.depth_unit_m)

    def close(self) -> None:
        self.closed = True


NEW = NewCapture("denim", "hanging", 0.35, {"panel": True})


def test_a_recording_that_fails_leaves_nothing_in_its_way(
    hanging: Sheet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise InputError("no space left", code="cannot_write")

    source, folder = StandInCamera(hanging.depth(CAMERA, turned_pose((0.0, 0.0, 0.0)))), tmp_path / "set"
    with monkeypatch.context() as failing, pytest.raises(InputError, match="no space left"):
        failing.setattr("capture.record.write_captures_json", full)
        record_capture(source, folder, NEW, frames=1)
    assert not list(folder.glob("*.png"))
    (folder / ".0123456789abcdef.part").touch()  # what is on its way to another file of the folder
    assert record_capture(source, folder, NEW, frames=1).endswith("-0")


def test_a_recording_becomes_a_capture_with_less_noise(hanging: Sheet, tmp_path: Path) -> None:
    still = hanging.depth(CAMERA, turned_pose((0.0, 4.0, 0.0)))
    with StandInCamera(still) as source:
        first = record_capture(source, tmp_path / "set", NEW, frames=15)
        assert source.given == 15
        second = record_capture(source, tmp_path / "set", NEW, frames=5)
    assert source.closed
    assert (first, second) == ("denim-hanging-0", "denim-hanging-1")
    found = CaptureSet.load(tmp_path / "set")
    assert [c.repeat for c in found.captures] == [0, 1]
    assert found.fabrics["denim"].density == 0.35
    depth = found.captures[0].read_depth()
    seen = (depth > 0) & (still > 0)
    assert seen.mean() > 0.99
    assert np.std((depth - still)[seen]) < 0.0015
    assert [path.name for path in (tmp_path / "set").glob(".*")] == [LOCK_FILE]  # and no part of a file


def test_another_camera_is_kept_with_its_capture(hanging: Sheet, tmp_path: Path) -> None:
    still = hanging.depth(CAMERA, turned_pose((0.0, 4.0, 0.0)))
    record_capture(StandInCamera(still), tmp_path, NEW, frames=1)
    other = Camera(320, 240, 250.0, 250.0, 160.0, 120.0)
    record_capture(StandInCamera(still, other), tmp_path, NewCapture("denim", "stretch"), frames=1)
    assert [c.camera for c in CaptureSet.load(tmp_path).captures] == [CAMERA, other]


def test_a_recording_that_fails_changes_nothing(hanging: Sheet, tmp_path: Path) -> None:
    still = hanging.depth(CAMERA, turned_pose((0.0, 4.0, 0.0)))
    record_capture(StandInCamera(still), tmp_path, NEW, frames=1)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    dark = StandInCamera(np.zeros_like(still))
    for source, new, code in (
        (dark, NEW, "depth_empty"),
        (StandInCamera(still), NewCapture("denim", "draping"), "scene_unknown"),
        (StandInCamera(still), NewCapture("silk", "hanging", -1.0), "parameter_out_of_range"),
        (StandInCamera(still), NewCapture("\udcff", "hanging"), "fabric_name"),
    ):
        with pytest.raises(InputError) as caught:
            record_capture(source, tmp_path, new, frames=2)
        assert caught.value.code == code
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_folder_with_other_things_is_left_alone(hanging: Sheet, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("dear")
    with pytest.raises(InputError) as caught:
        record_capture(StandInCamera(hanging.depth(CAMERA, turned_pose((0, 0, 0)))), tmp_path, NEW)
    assert caught.value.code == "folder_in_use"


frames_of = npst.arrays(np.uint16, st.tuples(st.integers(1, 7), st.just(3), st.just(4)), elements=st.integers(0, 9))


@given(frames_of)
@settings(max_examples=80, deadline=None)
def test_the_median_is_a_value_that_was_seen(stack: NDArray[np.uint16]) -> None:
    median = temporal_median(iter(stack))
    for row in range(3):
        for column in range(4):
            seen = np.sort(stack[:, row, column][stack[:, row, column] > 0])
            if len(seen) * 2 < len(stack) or not len(seen):
                assert median[row, column] == 0
            else:
                assert median[row, column] == seen[(len(seen) - 1) // 2]


def test_frames_of_several_scenes_are_told(hanging: Sheet) -> None:
    """Noise, flying pixels in single frames and pixels without data are those of one."""
    clean = hanging.depth(CAMERA, turned_pose((0.0, 4.0, 0.0)))
    rng = np.random.default_rng(3)
    still = []
    for number in range(20):
        frame = np.round(with_noise(clean, 0.003, 0.2, seed=number) / CAMERA.depth_unit_m).astype(np.uint16)
        frame[rng.random(frame.shape) < 0.02] = 5000
        still.append(frame)
    assert moving(still, CAMERA.depth_unit_m) == moving(still[:1], CAMERA.depth_unit_m) == []
    assert moving([np.zeros_like(still[0])] * 3, CAMERA.depth_unit_m) == []
    swung = [np.roll(frame, 12 * number, axis=1) for number, frame in enumerate(still[:5])]
    (note,) = moving(swung, CAMERA.depth_unit_m)
    assert note.startswith("the frames differ by more than") and "the cloth swung" in note


def test_the_median_needs_frames_of_one_size() -> None:
    with pytest.raises(InputError) as caught:
        temporal_median([])
    assert caught.value.code == "no_frames"
    with pytest.raises(InputError) as caught:
        temporal_median([np.ones((2, 2), np.uint16), np.ones((3, 2), np.uint16)])
    assert caught.value.code == "frames_differ"


def test_a_folder_of_pictures_is_a_source(tmp_path: Path) -> None:
    for number in (2, 0, 1):
        write_depth_png(tmp_path / f"frame-{number}.png", np.full((240, 320), 0.9 + 0.01 * number, np.float32))
    (tmp_path / "notes.txt").write_text("skipped")
    source = PngFolderSource(tmp_path, CAMERA)
    assert [int(frame[0, 0]) for frame in source.frames()] == [9000, 9100, 9200]
    with pytest.raises(InputError) as caught:
        list(PngFolderSource(tmp_path, Camera(32, 24, 30.0, 30.0, 16.0, 12.0)).frames())
    assert caught.value.code == "depth_wrong_size"
    with pytest.raises(InputError) as caught:
        PngFolderSource(tmp_path / "none", CAMERA)
    assert caught.value.code == "folder_missing"
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError) as caught:
        PngFolderSource(tmp_path / "empty", CAMERA)
    assert caught.value.code == "no_frames"


def test_a_camera_is_read_from_json(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(camera_document()))
    assert load_camera(path) == CAMERA
    path.write_text(json.dumps({"camera": camera_document()}))
    assert load_camera(path) == CAMERA
    for no_camera, told in (({"width": 3}, "is missing"), ({"camera": None}, "a camera is an object with width,")):
        path.write_text(json.dumps(no_camera))
        with pytest.raises(InputError, match=told) as caught:
            load_camera(path)
        assert caught.value.code == "capture_set_invalid"


def intrinsics(model: str, coeffs: list[float]) -> SimpleNamespace:
    return SimpleNamespace(width=640, height=480, fx=475.0, fy=474.0, ppx=318.0, ppy=242.0, model=model, coeffs=coeffs)


def test_a_lens_model_that_undoes_distortion_is_turned_round() -> None:
    inverse = [0.13, 0.05, 0.004, 0.0035, 0.02]
    camera = camera_from_intrinsics(intrinsics("distortion.inverse_brown_conrady", inverse), 1e-4)
    pixels = np.array([[60.0, 60.0], [560.0, 420.0], [318.0, 242.0]])
    x, y = (pixels[:, 0] - 318.0) / 475.0, (pixels[:, 1] - 242.0) / 474.0
    r2 = x * x + y * y
    radial = 1 + inverse[0] * r2 + inverse[1] * r2**2 + inverse[4] * r2**3
    true_x = x * radial + 2 * inverse[2] * x * y + inverse[3] * (r2 + 2 * x * x)
    true_y = y * radial + 2 * inverse[3] * x * y + inverse[2] * (r2 + 2 * y * y)
    found = camera.normalised_from_pixels(pixels)
    np.testing.assert_allclose(found, np.stack([true_x, true_y], axis=1), atol=0.3 / 475.0)


def test_a_lens_model_that_cannot_be_used_is_refused() -> None:
    with pytest.raises(InputError) as caught:
        camera_from_intrinsics(intrinsics("distortion.kannala_brandt4", [0.1, 0, 0, 0, 0]), 1e-3)
    assert caught.value.code == "distortion"
    assert not camera_from_intrinsics(intrinsics("distortion.kannala_brandt4", [0.0] * 5), 1e-3).distorted


def test_a_missing_driver_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(MissingResourceError, match="pip install") as caught:
        import_realsense()
    assert caught.value.code == "realsense_missing"


class SilentDriver(SimpleNamespace):
    """A test's driver: a camera that opens and never sends a frame."""

    def __init__(self) -> None:
        super().__init__(stream=SimpleNamespace(depth="depth"), format=SimpleNamespace(z16="z16"), stopped=0)
        lens = intrinsics("distortion.none", [0.0] * 5)
        stream = SimpleNamespace(as_video_stream_profile=lambda: SimpleNamespace(get_intrinsics=lambda: lens))
        sensor = SimpleNamespace(get_depth_scale=lambda: 1e-4)
        device = SimpleNamespace(first_depth_sensor=lambda: sensor)
        self.profile = SimpleNamespace(get_stream=lambda kind: stream, get_device=lambda: device)

    def config(self) -> SimpleNamespace:
        return SimpleNamespace(enable_stream=lambda *mode: None, enable_device=lambda serial: None)

    def pipeline(self) -> SimpleNamespace:
        return SimpleNamespace(
            start=lambda config: self.profile,
            try_wait_for_frames=lambda patience_ms: (False, None),
            stop=lambda: setattr(self, "stopped", self.stopped + 1),
        )


def test_a_camera_that_sends_nothing_is_told_and_adds_no_capture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = SilentDriver()
    monkeypatch.setattr("capture.realsense.import_realsense", lambda: driver)
    for serial, name in ((None, "camera"), ("0815", "camera 0815")):
        with (
            pytest.raises(MissingResourceError, match=f"^{name} sends no frames: check its USB 3 cable") as caught,
            RealSenseSource(serial=serial) as source,
        ):
            record_capture(source, tmp_path / "set", NEW, frames=3)
        assert caught.value.code == "camera_silent"
    assert driver.stopped == 2
    assert not list(tmp_path.rglob("*.png")) and not list(tmp_path.rglob("captures.json"))


def test_a_recording_of_the_drivers_own_is_replayed_whole(tmp_path: Path) -> None:
    """The driver's software device writes a real recording, which is then played frame by frame."""
    driver = pytest.importorskip("pyrealsense2")
    path = tmp_path / "recording.db3"
    _write_recording(driver, path)
    with RealSenseSource(path) as source:
        assert source.camera == Camera(64, 48, 50.0, 50.0, 31.5, 23.5, depth_unit_m=1e-4)
        seen = [int(frame[0, 0]) for frame in source.frames()]
    assert seen == list(range(9000, 9000 + len(seen)))
    assert len(seen) == 8
    with RealSenseSource(path) as source:
        name = record_capture(source, tmp_path / "set", NEW, frames=3)
    depth = CaptureSet.load(tmp_path / "set").captures[0].read_depth()
    assert name == "denim-hanging-0"
    assert depth[0, 0] == pytest.approx(0.9001)


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("pyrealsense2")
    for name, content, code in (
        ("none.bag", None, "recording_missing"),
        ("film.mp4", b"", "recording_unusable"),
        ("bad.db3", b"no", "recording_unusable"),
        ("bad.bag", b"no", "recording_unusable"),
    ):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError) as caught:
            RealSenseSource(tmp_path / name)
        assert caught.value.code == code


def _write_recording(driver: object, path: Path) -> None:
    rs: SimpleNamespace = driver  # type: ignore[assignment]  # a module used by its attributes
    device = rs.software_device()
    sensor = device.add_sensor("Depth")
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = 64, 48, 50.0, 50.0, 31.5, 23.5
    lens.model, lens.coeffs = rs.distortion.brown_conrady, [0.0] * 5
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.fps, stream.bpp = rs.stream.depth, 0, 1, 30, 2
    stream.width, stream.height, stream.fmt, stream.intrinsics = 64, 48, rs.format.z16, lens
    profile = sensor.add_video_stream(stream, True)
    sensor.add_read_only_option(rs.option.depth_units, 0.0001)
    recorder = rs.recorder(str(path), device)
    recorded = recorder.query_sensors()[0]
    queue = rs.frame_queue(50)
    recorded.open(recorded.get_stream_profiles()[0])
    recorded.start(queue)
    for number in range(8):
        frame = rs.software_video_frame()
        frame.stride, frame.bpp, frame.timestamp, frame.frame_number = 128, 2, 33.3 * number, number
        frame.domain, frame.profile = rs.timestamp_domain.hardware_clock, profile.as_video_stream_profile()
        frame.pixels = np.full((48, 64), 9000 + number, np.uint16)
        sensor.on_video_frame(frame)
        queue.wait_for_frame(2000)
    recorded.stop()
    recorded.close()
