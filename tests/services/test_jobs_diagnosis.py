"""`POST /v1/diagnoses`: a capture set as a ZIP, a gap report as the job's result."""

from __future__ import annotations

import asyncio
import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from fastapi import UploadFile
from fastapi.responses import JSONResponse
from jsonschema import validate
from sqlalchemy import select

from capture.capture_set import CaptureSet
from services.api.auth import EVERYBODY
from services.api.problems import ProblemError
from services.api.routes import diagnoses
from services.db.engine import Database
from services.db.jobs import Job
from services.jobs.archive import ArchiveLimits, unpack
from services.jobs.kinds.diagnosis import DiagnosisInputs, picture_names
from services.settings import Settings
from simcore.errors import InputError
from tests.services.served import SOFT, STIFF, drapemeter, finished, serving


def capture_set(folder: Path, *effect: str) -> bytes:
    """Two stiff fabrics, hanging and stretched, put up anew each time, as `drapemeter simulate` makes them."""
    for number, parameters in enumerate((STIFF, {**SOFT, "bending_warp": 3e-4, "bending_weft": 3e-4})):
        (folder / "p.json").write_text(json.dumps({**parameters, "bending_bias": 3e-4}))
        for scene in ("hanging", "stretch"):
            options = ["--scene", scene, "--parameters", str(folder / "p.json"), "--resolution", "0.05", *effect]
            options += ["--out", str(folder / "a.ply"), "--capture-set", str(folder / "set"), "--fabric", f"f{number}"]
            made = drapemeter(folder, "simulate", *options)
            assert made.returncode == 0, made.stderr
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted((folder / "set").iterdir()):
            archive.write(path, f"my captures/{path.name}")
    return stream.getvalue()


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_capture_set_is_diagnosed_as_a_job(tmp_path: Path, shared_dir: Path) -> None:
    content = capture_set(tmp_path)
    with serving(tmp_path) as running, running.client() as client:
        answer = client.post(
            "/v1/diagnoses",
            files={"capture_set": ("set.zip", content, "application/zip")},
            data={"effects": "air_draft,depth_scale", "resolution_m": "0.05"},
        )
        assert answer.status_code == 202, answer.text
        job = finished(client, answer.headers["location"])
        assert job["problem"] is None
        validate(job["result"], json.loads((shared_dir / "contracts" / "gap-report.schema.json").read_text()))
        assert [file["name"] for file in job["files"]] == ["report.html"]
        page = client.get(job["files"][0]["url"])
        assert page.headers["content-security-policy"] == "sandbox"
        assert page.text.lstrip().lower().startswith("<!doctype html")


@pytest.mark.timeout(400)
def test_captures_that_cannot_be_used_fail_the_job_with_a_code(tmp_path: Path, shared_dir: Path) -> None:
    stream = io.BytesIO()
    folder = shared_dir / "real" / "phisft-r1"
    with zipfile.ZipFile(stream, "w") as archive:
        for path in folder.iterdir():
            archive.writestr(path.name, path.read_bytes()[: -3000 if path.name.endswith("-1.png") else None])
    with serving(tmp_path) as running, running.client() as client:
        answer = client.post("/v1/diagnoses", files={"capture_set": ("set.zip", stream.getvalue())})
        job = finished(client, answer.headers["location"])
    assert (job["status"], job["problem"]["code"]) == ("failed", "depth_damaged")
    assert "r1-hanging-1.png" in job["problem"]["detail"]
    assert "/r1-hanging-1.png" not in job["problem"]["detail"]  # the server's own folders are nobody's business


def _renamed(folder: Path, path: str, stored: str) -> bytes:
    """A capture set whose first picture is called ``path`` and lies in the archive as ``stored``; a BOM before."""
    document = json.loads((folder / "captures.json").read_text())
    first = document["captures"][0]["depth"]
    document["captures"][0]["depth"] = path
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("captures.json", b"\xef\xbb\xbf" + json.dumps(document).encode())
        for file in folder.glob("*.png"):
            archive.writestr(stored if file.name == first else file.name, file.read_bytes())
    return stream.getvalue()


@pytest.mark.parametrize(
    ("path", "stored"),
    [("picture", "picture"), (".//x.png", "x.png"), ("f1:a.png", "f1:a.png"), ("a//b.png", "a/b.png")],
)
def test_pictures_are_found_by_whatever_path_names_them(
    path: str, stored: str, tmp_path: Path, shared_dir: Path
) -> None:
    content = _renamed(shared_dir / "real" / "phisft-r1", path, stored)
    document = diagnoses._check(content, Settings(), 0.01)
    unpack(content, tmp_path, ArchiveLimits(Settings().max_unpacked_bytes), picture_names(document))
    assert CaptureSet.load(tmp_path).captures[0].read_depth().max() > 0.0


def _stating(folder: Path, change: Callable[[dict[str, Any]], None]) -> bytes:
    """The real set, its ``captures.json`` changed."""
    document = json.loads((folder / "captures.json").read_text())
    change(document)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("captures.json", json.dumps(document))
        for file in folder.glob("*.png"):
            archive.writestr(file.name, file.read_bytes())
    return stream.getvalue()


PINS = {"top_left": [0.2, 0, 0], "top_right": [-0.2, 0, 0]}


@pytest.mark.parametrize(
    ("change", "code", "said"),
    [
        (lambda d: d["setup"].update(pins_m={"hanging": {"top_left": [0, 0, 0]}}), "pins_missing", "'r1-hanging-0'"),
        (lambda d: d["setup"].update(camera_from_panel=[[2, 0, 0, 0]] * 4), "pose", "'r1-hanging-0'"),
        (lambda d: d["setup"].update(pin_radius_m=0.3), "pin_radius", "'r1-hanging-0'"),
        (lambda d: d["captures"][1].update(setup={"pins_m": {"hanging": PINS}}), "pins_crossed", "r1-hanging-1: pin"),
        (
            lambda d: d["captures"][2].update(camera={**d["camera"], "width": 320}),
            "depth_wrong_size",
            "r1-hanging-2.png is 640 x 480 pixels, its camera says 320 x 480",
        ),
        (
            lambda d: d["captures"][1].update(setup={"sample_size_m": [0.3, 0.205]}),
            "resolution_does_not_divide",
            "r1-hanging-1: ",
        ),
    ],
)
def test_what_captures_json_alone_shows_to_be_unusable_is_refused(
    change: Callable[[dict[str, Any]], None], code: str, said: str, shared_dir: Path
) -> None:
    with pytest.raises(InputError, match=said) as caught:
        diagnoses._check(_stating(shared_dir / "real" / "phisft-r1", change), Settings(), 0.01)
    assert caught.value.code == code


def test_a_path_that_goes_up_is_refused(shared_dir: Path) -> None:
    with pytest.raises(InputError, match="must not go up"):
        diagnoses._check(_renamed(shared_dir / "real" / "phisft-r1", "a/../x.png", "x.png"), Settings(), 0.01)


def test_cells_that_do_not_divide_half_a_metre_are_the_diagnosiss_own_business() -> None:
    """It simulates whole cells whatever the sample's size."""
    assert DiagnosisInputs(resolution_m=0.03, most_bytes=1000).options().resolution_m == 0.03
    assert DiagnosisInputs(lpips=True, most_bytes=1000).options().lpips
    assert not DiagnosisInputs(most_bytes=1000).options().lpips


def test_the_same_request_is_the_same_under_another_limit_of_the_server(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diagnoses, "_check", lambda content, settings, resolution_m: None)

    def ask(most_bytes: int, resolution_m: float = 0.01) -> JSONResponse:
        state = SimpleNamespace(database=database, settings=Settings(max_unpacked_bytes=most_bytes))
        archive = UploadFile(io.BytesIO(b"a ZIP"))
        asked = diagnoses.create_diagnosis(
            state,  # type: ignore[arg-type]  # all that is looked at
            EVERYBODY,
            None,
            archive,
            resolution_m=resolution_m,
            idempotency_key="key",
        )
        return asyncio.run(asked)

    first, again = ask(10_000), ask(20_000)
    assert again.body == first.body and again.headers["idempotent-replayed"] == "true"
    with database.read() as session:
        (job,) = session.scalars(select(Job))
    assert job.inputs["most_bytes"] == 10_000 and job.inputs["resolution_m"] == 0.01
    with pytest.raises(ProblemError) as caught:
        ask(10_000, resolution_m=0.02)
    assert caught.value.code == "idempotency_key_reused"


def test_a_huge_picture_in_a_small_archive_is_refused_at_once(client: httpx.Client, shared_dir: Path) -> None:
    folder = shared_dir / "real" / "phisft-r1"
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in folder.iterdir():
            content = path.read_bytes()
            if path.suffix == ".png":
                content = content[:16] + struct.pack(">II", 60_000, 60_000) + content[24:]
            archive.writestr(path.name, content)
    answer = client.post("/v1/diagnoses", files={"capture_set": ("set.zip", stream.getvalue(), "application/zip")})
    assert (answer.status_code, answer.json()["code"]) == (422, "depth_too_large")
