"""`POST /v1/estimates`: pictures and a weight in, mechanics out."""

from __future__ import annotations

import io
import json
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image

from capture.report import BY_EDGES_ALONE
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from services.api.routes.estimates import MOST_REPEATS
from simcore.parameters import ESTIMATED_NAMES
from simcore.scenes import Scene
from tests.capture.sheets import CAMERA as SHEET_CAMERA
from tests.capture.sheets import camera_document, make_sheet, turned_pose, with_noise
from tests.services.served import serving


def depth_png(waves: float = 9.0) -> bytes:
    """A 256 x 256 picture of the canonical camera: folded cloth of half a metre before a panel, in 0.1 mm."""
    v, u = np.meshgrid(np.arange(256), np.arange(256), indexing="ij")
    distance = frontal_pose()[2, 3]
    x, y = (u - 127.5) / 320.0 * distance, (v - 127.5) / 320.0 * distance
    cloth = (np.abs(x) < 0.22) & (np.abs(y) < 0.25)
    height = np.where(cloth, 0.05 + 0.02 * np.sin(waves * 6.0 * x), 0.0)
    return encode(np.rint((distance - height) / 1e-4).astype(np.uint16))


def encode(counts: np.ndarray[Any, Any]) -> bytes:
    """16-bit PNG."""
    stream = io.BytesIO()
    Image.fromarray(counts).save(stream, "PNG")
    return stream.getvalue()


CAMERA = {
    "width": 256,
    "height": 256,
    "fx": CANONICAL_CAMERA.fx,
    "fy": CANONICAL_CAMERA.fy,
    "cx": CANONICAL_CAMERA.cx,
    "cy": CANONICAL_CAMERA.cy,
    "depth_unit_m": 1e-4,
}
SETUP = {"camera_from_panel": frontal_pose().tolist()}


def ask(
    client: httpx.Client, *, headers: dict[str, str] | None = None, density: str = "0.2", **files: bytes
) -> httpx.Response:
    """An estimate from pictures by scene."""
    data = {"density": density, "camera": json.dumps(CAMERA), "setup": json.dumps(SETUP)}
    parts = {scene: (f"{scene}.png", content, "image/png") for scene, content in files.items()}
    return client.post("/v1/estimates", data=data, files=parts, headers=headers)


@pytest.mark.parametrize("scenes", [("hanging",), ("stretch",), ("hanging", "stretch")])
def test_one_or_both_scenes_give_six_parameters_with_units(client: httpx.Client, scenes: tuple[str, ...]) -> None:
    answer = ask(client, **dict.fromkeys(scenes, depth_png()))
    assert answer.status_code == 200, answer.text
    body = answer.json()
    assert set(body["parameters"]) == set(ESTIMATED_NAMES) == set(body["units"]) == set(body["intervals_90"])
    for name, value in body["parameters"].items():
        low, high = body["intervals_90"][name]
        assert low <= value <= high
    assert body["units"]["bending_warp"] == "N·m"
    assert body["scenes"] == list(scenes) and body["notes"] == []
    assert isinstance(body["out_of_distribution"], bool)
    assert body["intervals_calibrated"] is False  # the test's model was calibrated on few fabrics
    assert len(body["model_version"]) > 6


def test_a_pose_that_is_found_by_edges_alone_is_noted(client: httpx.Client) -> None:
    depth = make_sheet(Scene.STRETCH).depth(SHEET_CAMERA, turned_pose((1.0, 4.0, 1.5)))
    content = encode(np.rint(with_noise(depth, 0.0005, 0.01) / 1e-4).astype(np.uint16))
    data = {"density": "0.2", "camera": json.dumps(camera_document(SHEET_CAMERA))}
    answer = client.post("/v1/estimates", data=data, files={"stretch": ("s.png", content)})
    assert answer.status_code == 200, answer.text
    assert answer.json()["notes"] == [f"capture stretch-0: {BY_EDGES_ALONE}"]


def test_a_density_beyond_the_trained_ones_is_a_reason(client: httpx.Client) -> None:
    usual, heavy = (ask(client, density=density, hanging=depth_png()).json() for density in ("0.2", "4.9"))
    assert usual["out_of_distribution_reasons"] == []
    (reason,) = heavy["out_of_distribution_reasons"]
    assert reason.startswith("the density 4.9 kg/m² is beyond the ") and heavy["out_of_distribution"] is True


def test_repeats_are_taken_together(client: httpx.Client) -> None:
    files = [("hanging", ("a.png", depth_png())), ("hanging", ("b.png", depth_png(8.0)))]
    answer = client.post("/v1/estimates", data={"density": "0.2", "setup": json.dumps(SETUP)}, files=files)
    assert answer.status_code == 200, answer.text


def test_the_same_key_and_pictures_give_the_stored_answer(client: httpx.Client) -> None:
    headers = {"Idempotency-Key": "estimate-1"}
    first = ask(client, headers=headers, hanging=depth_png())
    again = ask(client, headers=headers, hanging=depth_png())  # another multipart boundary, the same content
    assert first.json() == again.json()
    assert "idempotent-replayed" not in first.headers
    assert again.headers["idempotent-replayed"] == "true"
    other = ask(client, headers=headers, hanging=depth_png(7.0))
    assert other.json()["code"] == "idempotency_key_reused"


def huge_png() -> bytes:
    """A few bytes that promise 60000 x 60000 pixels."""
    header = struct.pack(">IIBBBBB", 60000, 60000, 16, 0, 0, 0, 0)
    chunk = b"IHDR" + header
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk)) + bytes(40)


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"no picture", "depth_not_png"),
        (huge_png(), "depth_too_large"),
        (depth_png()[:-200], "depth_damaged"),
        (encode(np.zeros((256, 256), np.uint16)), "depth_empty"),
        (encode(np.full((256, 256), 200, np.uint8)), "depth_not_16_bit"),
        (encode(np.full((100, 120), 9000, np.uint16)), "depth_wrong_size"),
    ],
)
def test_unusable_pictures_are_named_by_code(client: httpx.Client, content: bytes, code: str) -> None:
    answer = ask(client, hanging=content)
    assert (answer.status_code, answer.json()["code"]) == (422, code), answer.text
    assert "/tmp" not in answer.text  # the server's own folders are nobody's business


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({}, "validation_failed"),
        ({"density": "heavy"}, "validation_failed"),
        ({"density": "nan"}, "validation_failed"),
        ({"density": "200"}, "validation_failed"),
        ({"density": "0.2", "camera": "{"}, "camera_invalid"),
        ({"density": "0.2", "camera": '{"width": 256}'}, "camera_invalid"),
        ({"density": "0.2", "setup": '{"sample_size_m": [0.5]}'}, "setup_invalid"),
        ({"density": "0.2", "setup": '{"sample_size_m": [50, 50]}'}, "sample_size"),
        ({"density": "0.2", "setup": '{"pin_distance_m": NaN}'}, "setup_invalid"),
    ],
)
def test_unusable_fields_are_named_by_code(client: httpx.Client, fields: dict[str, str], code: str) -> None:
    answer = client.post("/v1/estimates", data=fields, files={"hanging": ("h.png", depth_png())})
    assert (answer.status_code, answer.json()["code"]) == (422, code), answer.text


def test_a_picture_is_needed(client: httpx.Client) -> None:
    answer = client.post("/v1/estimates", data={"density": "0.2"})
    assert answer.json()["code"] == "no_captures"
    answer = client.post("/v1/estimates", data={"density": "0.2"}, files={"other": ("x.png", b"")})
    assert answer.json()["errors"][0]["pointer"] == "body/other"


def test_only_so_many_repeats_are_taken(client: httpx.Client) -> None:
    files = [("stretch", (f"{n}.png", depth_png())) for n in range(MOST_REPEATS + 1)]
    answer = client.post("/v1/estimates", data={"density": "0.2"}, files=files)
    assert (answer.status_code, answer.json()["code"]) == (422, "too_many_captures")
    assert f"at most {MOST_REPEATS} pictures of each scene" in answer.json()["detail"]


def test_another_camera_must_be_described(client: httpx.Client) -> None:
    picture = encode(np.full((480, 640), 9000, np.uint16))
    answer = client.post("/v1/estimates", data={"density": "0.2"}, files={"hanging": ("h.png", picture)})
    assert answer.json()["code"] == "camera_missing"


def test_a_real_capture_is_estimated(client: httpx.Client, shared_dir: Path) -> None:
    folder = shared_dir / "real" / "phisft-r1"
    described = json.loads((folder / "captures.json").read_text())
    data = {"density": "0.2", "camera": json.dumps(described["camera"]), "setup": json.dumps(described["setup"])}
    files = [("hanging", (f"{n}.png", (folder / f"r1-hanging-{n}.png").read_bytes())) for n in range(3)]
    answer = client.post("/v1/estimates", data=data, files=files)
    assert answer.status_code == 200, answer.text
    assert answer.json()["scenes"] == ["hanging"]


def test_without_a_model_the_answer_says_so(tmp_path: Path) -> None:
    with serving(tmp_path, "--workers", "0", "--model", str(tmp_path / "none")) as running, running.client() as client:
        assert client.get("/readyz").json()["model"] == "absent"
        answer = ask(client, hanging=depth_png())
        assert (answer.status_code, answer.json()["code"]) == (503, "model_missing")
        assert int(answer.headers["retry-after"]) > 0


def test_too_many_at_once_are_told_when_to_come_back(tmp_path: Path, tiny_model_folder: Path) -> None:
    options = {"DRAPEMETER_ESTIMATE_QUEUE": "1"}
    with (
        serving(tmp_path, "--workers", "0", "--model", str(tiny_model_folder), **options) as running,
        running.client() as client,
        ThreadPoolExecutor(4) as pool,
    ):
        answers = list(pool.map(lambda _: ask(client, hanging=depth_png()), range(4)))
    assert {a.status_code for a in answers} == {200, 503}
    refused = next(a for a in answers if a.status_code == 503)
    assert refused.json()["code"] == "estimates_saturated"
    assert int(refused.headers["retry-after"]) >= 1


def test_an_estimate_that_takes_too_long_is_stopped(tmp_path: Path, tiny_model_folder: Path) -> None:
    options = {"DRAPEMETER_ESTIMATE_TIMEOUT_S": "0.2"}  # less than it takes to load the network
    with (
        serving(tmp_path, "--workers", "0", "--model", str(tiny_model_folder), **options) as running,
        running.client() as client,
    ):
        answer = ask(client, hanging=depth_png())
        assert (answer.status_code, answer.json()["code"]) == (503, "estimate_timed_out")
        assert client.get("/healthz").status_code == 200
