"""Errors are RFC 9457 problems with a stable code, whatever went wrong."""

from __future__ import annotations

import errno
import io
import json
import zipfile
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from starlette.exceptions import HTTPException

from services.api.problems import install_problem_handlers, problem_response
from tests.services.served import QUICK, SOFT, STIFF

Request = tuple[str, str, dict[str, Any]]
COMPARE = {"a": STIFF, "b": SOFT, **QUICK}


def problem(answer: httpx.Response) -> dict[str, Any]:
    """A problem document, checked for form."""
    assert answer.headers["content-type"] == "application/problem+json"
    body: dict[str, Any] = answer.json()
    assert {"type", "title", "status", "code", "detail", "instance", "request_id"} <= set(body)
    assert body["status"] == answer.status_code
    assert body["type"] == f"urn:drapemeter:problem:{body['code']}"
    assert body["request_id"] == answer.headers["x-request-id"]
    return body


@pytest.mark.parametrize(
    ("method", "path", "options", "status", "code"),
    [
        ("GET", "/nowhere", {}, 404, "not_found"),
        ("GET", "/v1/fabrics/", {}, 404, "not_found"),
        ("PATCH", "/v1/fabrics", {}, 405, "method_not_allowed"),
        ("GET", "/v1/jobs/job_unknown", {}, 404, "job_not_found"),
        ("DELETE", "/v1/jobs/job_unknown", {}, 404, "job_not_found"),
        ("GET", "/v1/fabrics/fab_unknown", {}, 404, "fabric_not_found"),
        ("GET", "/v1/fabrics?cursor=AAAA", {}, 422, "cursor_invalid"),
        ("GET", "/v1/fabrics?limit=0", {}, 422, "validation_failed"),
        (
            "POST",
            "/v1/drape-distances",
            {"content": b"{", "headers": {"content-type": "application/json"}},
            422,
            "validation_failed",
        ),
        ("POST", "/v1/drape-distances", {"json": {**COMPARE, "a": {**STIFF, "density": -1}}}, 422, "validation_failed"),
        ("POST", "/v1/drape-distances", {"json": {**COMPARE, "extra": 1}}, 422, "validation_failed"),
        (
            "POST",
            "/v1/drape-distances",
            {"json": {**COMPARE, "resolution_m": 0.013}},
            422,
            "resolution_does_not_divide",
        ),
        ("POST", "/v1/drape-distances", {"json": {**COMPARE, "backend": "psychic"}}, 422, "backend_unknown"),
        ("POST", "/v1/fabrics/search", {"json": {**QUICK}}, 422, "reference_missing"),
        ("POST", "/v1/fabrics/search", {"json": {**QUICK, "fabric_id": "fab_x"}}, 404, "fabric_not_found"),
        ("POST", "/v1/datasets", {"json": {"materials": 0}}, 422, "validation_failed"),
        ("POST", "/v1/datasets", {"json": {"materials": 2, "scenes": ["hanging", "hanging"]}}, 422, "scenes"),
        ("POST", "/v1/diagnoses", {"files": {"capture_set": ("a.zip", b"no zip")}}, 422, "archive_not_zip"),
        (
            "POST",
            "/v1/diagnoses",
            {"files": {"capture_set": ("a.zip", b"")}, "data": {"effects": "witchcraft"}},
            422,
            "effect_unknown",
        ),
        (
            "POST",
            "/v1/diagnoses",
            {"files": {"capture_set": ("a.zip", b"")}, "data": {"effects": " , "}},
            422,
            "no_effects",
        ),
    ],
)
def test_bad_requests_get_a_problem_with_a_code(
    client: httpx.Client, method: str, path: str, options: dict[str, Any], status: int, code: str
) -> None:
    answer = client.request(method, path, **options)
    assert answer.status_code == status, answer.text
    assert problem(answer)["code"] == code


@pytest.mark.parametrize(("path", "field"), [("/v1/diagnoses", "efects"), ("/v1/estimates", "setp")])
def test_a_misspelt_field_of_a_form_is_not_passed_over(client: httpx.Client, path: str, field: str) -> None:
    """JSON bodies refuse it, too."""
    files = {"capture_set": ("a.zip", b"")} if path == "/v1/diagnoses" else {"hanging": ("a.png", b"")}
    density = {} if path == "/v1/diagnoses" else {"density": "0.2"}
    answer = client.post(path, files=files, data={field: "air_draft", **density})
    assert answer.status_code == 422
    (wrong,) = problem(answer)["errors"]
    assert (wrong["pointer"], wrong["code"]) == (f"body/{field}", "extra_forbidden")
    assert ", ".join(files) in wrong["detail"]


@pytest.mark.parametrize(
    ("path", "kind", "wanted"),
    [
        ("/v1/fabrics", "application/x-www-form-urlencoded", "application/json"),
        ("/v1/fabrics", "text/plain", "application/json"),
        ("/v1/diagnoses", "application/zip", "multipart/form-data"),
        ("/v1/estimates", "application/json", "multipart/form-data"),
    ],
)
def test_a_body_of_another_kind_is_told_what_is_wanted(client: httpx.Client, path: str, kind: str, wanted: str) -> None:
    answer = client.post(path, content=b'{"name": "a"}', headers={"content-type": kind})
    assert (answer.status_code, problem(answer)["code"]) == (415, "media_type_unsupported")
    assert kind in answer.json()["detail"] and wanted in answer.json()["detail"]


def test_what_is_given_twice_is_no_guess_at_the_last(client: httpx.Client) -> None:
    files = [("capture_set", ("a.zip", b""))]
    answer = client.post("/v1/diagnoses", files=files, data={"effects": ["air_draft", "panel_tilt"]})
    (wrong,) = problem(answer)["errors"]
    assert answer.status_code == 422 and (wrong["pointer"], wrong["code"]) == ("body/effects", "given_twice")
    answer = client.post("/v1/diagnoses", files=[*files, *files])
    assert problem(answer)["errors"][0]["pointer"] == "body/capture_set"
    answer = client.get("/v1/fabrics", params={"plm_id": ["a", "b"]})
    assert problem(answer)["errors"][0] == {**wrong, "pointer": "query/plm_id"}
    pictures = [("stretch", ("a.png", b"")), ("stretch", ("b.png", b""))]  # several may be sent
    answer = client.post("/v1/estimates", files=pictures, data={"density": "0.2", "camera": "{}"})
    assert problem(answer)["code"] != "validation_failed"


def test_half_a_character_in_what_is_said_is_written_out() -> None:
    answer = problem_response(422, "camera", "\ud800: give a number", "/v1/estimates")
    assert json.loads(bytes(answer.body))["detail"] == "\\ud800: give a number"


def test_a_misspelt_filter_does_not_list_everything(client: httpx.Client) -> None:
    answer = client.get("/v1/fabrics", params={"plmSystem": "windchill"})
    assert answer.status_code == 422 and problem(answer)["errors"][0]["pointer"] == "query/plmSystem"


@pytest.mark.parametrize("path", ["/healthz", "/v1/fabrics", "/v1/jobs/job_unknown", "/openapi.json"])
def test_head_is_get_without_its_body(client: httpx.Client, path: str) -> None:
    asked, whole = client.head(path), client.get(path)
    assert (asked.status_code, asked.content) == (whole.status_code, b"")
    assert asked.headers["content-type"] == whole.headers["content-type"]


def test_the_instance_of_a_problem_is_a_reference(client: httpx.Client) -> None:
    assert problem(client.get("/v1/fabrics/f%C3%BC%20x"))["instance"] == "/v1/fabrics/f%C3%BC%20x"


def test_numbers_that_json_does_not_have_are_refused(client: httpx.Client) -> None:
    text = '{"a": {"density": NaN}, "b": {"density": Infinity}}'
    answer = client.post("/v1/drape-distances", content=text, headers={"content-type": "application/json"})
    assert answer.status_code == 422
    assert problem(answer)["errors"]


def test_a_body_that_cannot_be_read_says_how_it_should_be(client: httpx.Client) -> None:
    answer = client.post("/v1/fabrics", content=b'{"name": "caf\xe9"}', headers={"content-type": "application/json"})
    assert (answer.status_code, problem(answer)["code"]) == (400, "bad_request")
    assert "UTF-8" in problem(answer)["detail"]


def test_other_keys_beside_the_seven_are_passed_over(client: httpx.Client) -> None:
    """As `fabric-parameters.schema.json` allows them, and the command line does."""
    answer = client.post("/v1/fabrics", json={"name": "noted", "parameters": {**STIFF, "note": "from the mill"}})
    assert answer.status_code == 201, answer.text
    gone = client.delete(answer.headers["location"], headers={"If-Match": answer.headers["etag"]})
    assert gone.status_code == 204  # before anything else may fail: others count this server's fabrics
    assert answer.json()["parameters"] == STIFF


def test_validation_problems_name_the_field(client: httpx.Client) -> None:
    answer = client.post("/v1/drape-distances", json={**COMPARE, "b": {**SOFT, "bending_warp": "soft"}})
    assert problem(answer)["errors"][0]["pointer"] == "body/b/bending_warp"


def test_of_many_wrong_fields_some_are_told_and_all_counted(client: httpx.Client) -> None:
    answer = client.post("/v1/drape-distances", json={**COMPARE, **{f"x{n}": 0 for n in range(150)}})
    assert len(problem(answer)["errors"]) == 100 and "(and 149 more)" in problem(answer)["detail"]


def test_a_full_disk_is_no_fault_of_who_sent_the_upload() -> None:
    """As the framework hands on what fails while a form is read."""
    app = FastAPI()
    install_problem_handlers(app)

    @app.get("/")
    def read() -> None:
        raise HTTPException(400, "There was an error parsing the body") from OSError(errno.ENOSPC, "No space left")

    answer = TestClient(app).get("/")
    assert (answer.status_code, answer.json()["code"], answer.headers["retry-after"]) == (503, "no_room", "60")


DRAFT = {"format": "drapemeter-simulator/1", "effects": [{"name": "air_draft", "size": {"magnitude": "0.3"}}]}


@pytest.mark.parametrize(
    ("path", "body", "field"),
    [
        ("datasets", {"materials": "2"}, "materials"),
        ("datasets", {"materials": 2, "jitters": True}, "jitters"),
        ("datasets", {"materials": 2, "inclinations": 1.5}, "inclinations"),
        ("datasets", {"materials": 2, "resolution_m": "0.05"}, "resolution_m"),
        ("datasets", {"materials": 2, "seed": False}, "seed"),
        ("datasets", {"materials": 2, "sensor": "kinect"}, "sensor"),
        ("datasets", {"materials": 2, "simulator": {"effects": [], "pin_radius_m": "0"}}, "simulator/pin_radius_m"),
        ("datasets", {"materials": 2, "simulator": DRAFT}, "simulator/effects/0/size/magnitude"),
        ("drape-distances", {**COMPARE, "simulations": True}, "simulations"),
        ("fabrics/search", {**QUICK, "reference": STIFF, "limit": "5"}, "limit"),
    ],
)
def test_a_text_or_a_truth_value_is_no_number(
    client: httpx.Client, path: str, body: dict[str, Any], field: str
) -> None:
    answer = client.post(f"/v1/{path}", json=body)
    assert answer.status_code == 422
    assert [error["pointer"] for error in problem(answer)["errors"]] == [f"body/{field}"]


def test_whole_numbers_may_have_a_point(client: httpx.Client) -> None:
    """As JSON Schema has it; what is refused is the scene given twice."""
    answer = client.post("/v1/datasets", json={"materials": 2.0, "seed": 1.0, "scenes": ["hanging"] * 2})
    assert problem(answer)["code"] == "scenes"


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("POST", "/openapi.json", "GET, HEAD"),
        ("PATCH", "/v1/fabrics", "GET, HEAD, POST"),
        ("POST", "/v1/fabrics/fab_x", "DELETE, GET, HEAD, PUT"),
    ],
)
def test_a_method_that_a_path_does_not_have_is_told_which_it_has(
    client: httpx.Client, method: str, path: str, allowed: str
) -> None:
    answer = client.request(method, path)
    assert (answer.status_code, answer.headers["allow"]) == (405, allowed)


def test_a_request_longer_than_allowed_is_refused_whether_announced_or_not(client: httpx.Client) -> None:
    long = b"x" * (3 * 1024 * 1024)

    def chunks() -> Any:
        yield from (long[i : i + 2**18] for i in range(0, len(long), 2**18))

    answered = 0
    for content in (long, chunks()):
        try:
            answer = client.post("/v1/fabrics", content=content, headers={"content-type": "application/json"})
        except httpx.WriteError:
            continue  # the server has answered and hung up while we were still sending
        assert problem(answer)["code"] == "request_too_large"
        assert answer.status_code == 413
        answered += 1
    assert answered


def archive(files: dict[str, bytes]) -> bytes:
    """A ZIP of these files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as writer:
        for name, content in files.items():
            writer.writestr(name, content)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("files", "code"),
    [
        ({"../captures.json": b"{}"}, "archive_unsafe"),
        ({"/captures.json": b"{}"}, "archive_unsafe"),
        ({"captures.json": b"{}", "..\\evil.png": b""}, "archive_unsafe"),
        ({"depth.png": b""}, "captures_json_missing"),
        ({"captures.json": b"{}"}, "capture_format_unknown"),
        ({"captures.json": b"{}", "C:evil.png": b""}, "archive_unsafe"),
        ({"captures.json": b"{}", "bomb.png": bytes(5 * 1024 * 1024)}, "archive_too_large"),
    ],
)
def test_unsafe_archives_are_refused(client: httpx.Client, files: dict[str, bytes], code: str) -> None:
    answer = client.post("/v1/diagnoses", files={"capture_set": ("set.zip", archive(files))})
    assert answer.status_code == 422
    assert problem(answer)["code"] == code
