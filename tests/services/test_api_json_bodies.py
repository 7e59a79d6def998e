"""A key twice in one object of a JSON body is refused, as in files, forms and queries."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.params import Form
from fastapi.routing import APIRoute
from fastapi.testclient import TestClient

from services.api.app import create_app
from services.api.forms import TWICE
from services.api.json_body import JsonRoute
from services.db.engine import Database
from services.db.migrate import upgrade
from services.settings import Settings
from tests.services.served import QUICK, SOFT, STIFF

HEADERS = {"content-type": "application/json"}


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """A server in this process, without workers."""
    place = f"sqlite:///{tmp_path_factory.mktemp('bodies')}/test.db"
    database = Database(place)
    upgrade(database)
    database.close()
    settings = Settings(database=place, model=Path("none"), workers=0)
    with TestClient(create_app(settings), base_url="http://127.0.0.1") as opened:
        yield opened


def refused(answer: httpx.Response) -> str:
    """Where the key is that was given twice."""
    body = answer.json()
    assert (answer.status_code, body["code"]) == (422, "validation_failed"), answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    (wrong,) = body["errors"]
    assert (wrong["code"], wrong["detail"]) == ("given_twice", TWICE)
    assert body["detail"] == f"{wrong['pointer']}: {TWICE}"
    return str(wrong["pointer"])


def with_twice(body: dict[str, Any], key: str) -> str:
    """The body with a key of it once more, at its end."""
    return f"{json.dumps(body)[:-1]}, {json.dumps(key)}: {json.dumps(body[key])}}}"


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/v1/fabrics", {"name": "a", "parameters": STIFF}),
        ("PUT", "/v1/fabrics/fab_x", {"name": "a", "parameters": STIFF}),
        ("POST", "/v1/fabrics/search", {"reference": STIFF, **QUICK}),
        ("POST", "/v1/drape-distances", {"a": STIFF, "b": SOFT, **QUICK}),
        ("POST", "/v1/datasets", {"materials": 2}),
    ],
)
def test_a_key_twice_in_a_body_is_no_guess_at_the_last(
    client: TestClient, method: str, path: str, body: dict[str, Any]
) -> None:
    for key in body:
        answer = client.request(method, path, content=with_twice(body, key), headers=HEADERS)
        assert refused(answer) == f"body/{key}"
    assert client.get("/v1/fabrics").json()["items"] == []


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (f'{{"a": {with_twice(STIFF, "density")}, "b": {json.dumps(SOFT)}}}', "body/a/density"),
        ('{"scenes": [0, {"x": {"y": 1, "y": 1}}, {"z": 1, "z": 1}]}', "body/scenes/1/x/y"),
        ('[{"x": 1}, {"x": 1, "y": 2, "y": 2, "x": 1}]', "body/1/x"),
        ('{"a": {"x": 1, "x": 2}, "a": 3}', "body/a"),
        (r'{"a": 1, "\u0061": 2}', "body/a"),
    ],
)
def test_a_key_twice_is_found_however_deep(client: TestClient, text: str, place: str) -> None:
    for path in ("/v1/drape-distances", "/v1/datasets"):
        assert refused(client.post(path, content=text, headers={"content-type": "application/vnd.x+json"})) == place


def test_half_a_character_in_a_key_is_written_out(client: TestClient) -> None:
    assert refused(client.post("/v1/fabrics", content=r'{"\ud800": 1, "\ud800": 2}', headers=HEADERS)) == r"body/\ud800"


def test_what_is_no_json_is_told_as_before(client: TestClient) -> None:
    for content, status, code in (
        (b"{", 422, "validation_failed"),
        (b'{"name": "caf\xe9"}', 400, "bad_request"),
        (b"[" * 20_000, 400, "bad_request"),
        (b'{"x":' * 900 + b'{"a": 1, "a": 1}' + b"}" * 900, 400, "bad_request"),
        (b"", 422, "validation_failed"),
    ):
        answer = client.post("/v1/fabrics", content=content, headers=HEADERS)
        assert (answer.status_code, answer.json()["code"]) == (status, code), content[:20]
    answer = client.post("/v1/fabrics", content=b'{"a": 1, "a": 2}', headers={"content-type": "text/plain"})
    assert (answer.status_code, answer.json()["code"]) == (415, "media_type_unsupported")


def test_what_is_given_once_is_taken(client: TestClient) -> None:
    body = {"name": "a", "parameters": {**STIFF, "name": "a", "note": [{"name": "a"}, {"name": "a"}]}}
    answer = client.post("/v1/fabrics", json=body)
    assert answer.status_code == 201, answer.text
    assert client.delete(answer.headers["location"]).status_code == 204


def test_every_route_with_a_json_body_looks_for_keys_given_twice(client: TestClient) -> None:
    routes = [route for route in client.app.state.api_routes if isinstance(route, APIRoute)]  # type: ignore[attr-defined]
    taking = [route for route in routes if route.body_field and not isinstance(route.body_field.field_info, Form)]
    assert len(taking) == 5
    assert all(isinstance(route, JsonRoute) for route in taking)
