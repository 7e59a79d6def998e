"""The fabric library: adding, reading, paging, product-lifecycle references, search by drape."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest
from fastapi.responses import JSONResponse
from sqlalchemy.orm import Session

from services.api.auth import EVERYBODY
from services.api.idempotency import Answer, Once, fingerprint
from services.api.problems import ProblemError
from services.db.engine import Database
from tests.services.served import QUICK, SOFT, STIFF, finished, serving


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A server with an empty library."""
    with serving(tmp_path_factory.mktemp("library"), "--workers", "0") as running, running.client() as client:
        yield client


def add(client: httpx.Client, name: str, **more: Any) -> httpx.Response:
    return client.post("/v1/fabrics", json={"name": name, "parameters": STIFF, **more})


def reference(**changes: str) -> dict[str, str]:
    return {"system": "windchill", "id": uuid.uuid4().hex, "revision": "A", **changes}


def test_a_fabric_is_added_and_read_back(library: httpx.Client) -> None:
    ref = reference()
    added = add(library, "Köper 200", plm_ref=ref, attributes={"composition": "cotton"})
    assert added.status_code == 201
    read = library.get(added.headers["location"])
    assert read.json() == added.json()
    assert read.json()["plm_ref"] == ref
    assert read.json()["parameters"] == STIFF
    assert read.headers["etag"] == added.headers["etag"]
    unchanged = library.get(added.headers["location"], headers={"If-None-Match": read.headers["etag"]})
    assert (unchanged.status_code, unchanged.content) == (304, b"")


def test_a_plm_reference_is_taken_once(library: httpx.Client) -> None:
    ref = reference()
    assert add(library, "one", plm_ref=ref).status_code == 201
    again = add(library, "two", plm_ref=ref)
    assert (again.status_code, again.json()["code"]) == (409, "plm_ref_taken")
    assert add(library, "next revision", plm_ref={**ref, "revision": "B"}).status_code == 201
    found = library.get("/v1/fabrics", params={"plm_system": "windchill", "plm_id": ref["id"]}).json()
    assert [f["plm_ref"]["revision"] for f in found["items"]] == ["A", "B"]


def test_a_fabric_is_changed_only_in_the_version_that_is_meant(library: httpx.Client) -> None:
    added = add(library, "before", plm_ref=reference())
    place, first = added.headers["location"], added.headers["etag"]
    changed = library.put(place, json={"name": "after", "parameters": SOFT}, headers={"If-Match": first})
    assert changed.status_code == 200
    assert (changed.json()["name"], changed.json()["plm_ref"], changed.json()["version"]) == ("after", None, 2)
    assert changed.headers["etag"] != first
    late = library.put(place, json={"name": "too late", "parameters": SOFT}, headers={"If-Match": first})
    assert (late.status_code, late.json()["code"]) == (412, "version_changed")
    assert library.delete(place, headers={"If-Match": first}).status_code == 412
    assert library.get(place).json() == changed.json()
    assert library.delete(place).status_code == 204
    assert library.get(place).status_code == library.delete(place).status_code == 404


def test_a_change_cannot_take_anothers_plm_reference(library: httpx.Client) -> None:
    ref = reference()
    first, second = add(library, "one", plm_ref=ref), add(library, "two")
    body = {"name": "two", "parameters": STIFF, "plm_ref": ref}
    assert library.put(second.headers["location"], json=body).json()["code"] == "plm_ref_taken"
    assert library.put(first.headers["location"], json=body).status_code == 200


def test_two_at_once_with_one_key_make_one_fabric(library: httpx.Client) -> None:
    name, headers = uuid.uuid4().hex, {"Idempotency-Key": uuid.uuid4().hex}
    body = {"name": name, "parameters": SOFT}
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda _: library.post("/v1/fabrics", json=body, headers=headers), range(8)))
    assert {a.status_code for a in answers} == {201}
    assert len({a.json()["id"] for a in answers}) == 1


def test_a_refused_request_may_be_mended_under_its_key(library: httpx.Client) -> None:
    ref, headers = reference(), {"Idempotency-Key": uuid.uuid4().hex}
    add(library, "there", plm_ref=ref)
    body = {"name": "mended", "parameters": SOFT}
    assert library.post("/v1/fabrics", json={**body, "plm_ref": ref}, headers=headers).status_code == 409
    assert library.post("/v1/fabrics", json=body, headers=headers).status_code == 201


def test_pages_hold_every_fabric_once_also_while_some_are_added(library: httpx.Client) -> None:
    made = [add(library, f"page {n}").json()["id"] for n in range(7)]
    seen: list[str] = []
    cursor = None
    while True:
        params = {"limit": 3} if cursor is None else {"limit": 3, "cursor": cursor}
        page = library.get("/v1/fabrics", params=params).json()
        seen += [f["id"] for f in page["items"]]
        add(library, "meanwhile") if len(seen) == 3 else None
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert len(seen) == len(set(seen))
    assert set(made) <= set(seen)


def test_fabrics_are_found_by_any_part_of_their_reference(library: httpx.Client) -> None:
    ref = {"system": "centric", "id": "F-77", "revision": "A"}
    ids = [add(library, r, plm_ref={**ref, "revision": r}).json()["id"] for r in "AB"]
    for params, found in (
        ({"plm_system": "centric", "plm_id": "F-77"}, ids),
        ({"plm_system": "centric", "plm_id": "F-77", "plm_revision": "B"}, ids[1:]),
    ):
        assert [f["id"] for f in library.get("/v1/fabrics", params=params).json()["items"]] == found


def test_a_page_shows_what_was_added_after_others_were_deleted(library: httpx.Client) -> None:
    made = [add(library, f"deleted {n}").json()["id"] for n in range(3)]
    cursor, last = None, ""
    while last != made[1]:  # a page that ends with the last but one
        params = {"limit": 1} if cursor is None else {"limit": 1, "cursor": cursor}
        page = library.get("/v1/fabrics", params=params).json()
        cursor, last = page["next_cursor"], page["items"][-1]["id"]
    for fabric in made[1:]:
        assert library.delete(f"/v1/fabrics/{fabric}").status_code == 204
    new = add(library, "new").json()["id"]
    assert new in [f["id"] for f in library.get("/v1/fabrics", params={"limit": 100, "cursor": cursor}).json()["items"]]


@pytest.mark.parametrize(
    "change",
    [
        {"name": ""},
        {"name": "x" * 201},
        {"name": "a\x00b"},
        {"parameters": {**STIFF, "density": 200}},
        {"parameters": {k: v for k, v in STIFF.items() if k != "density"}},
        {"plm_ref": {"system": "windchill"}},
        {"attributes": {"a": 1}},
        {"surprise": True},
    ],
)
def test_unusable_fabrics_are_refused(library: httpx.Client, change: dict[str, Any]) -> None:
    answer = library.post("/v1/fabrics", json={"name": "x", "parameters": STIFF, **change})
    assert (answer.status_code, answer.json()["code"]) == (422, "validation_failed")


@pytest.mark.timeout(400)
def test_a_search_sent_again_is_answered_when_its_fabric_is_gone(client: httpx.Client) -> None:
    fabric = client.post("/v1/fabrics", json={"name": "gone", "parameters": STIFF}).json()["id"]
    headers, body = {"Idempotency-Key": uuid.uuid4().hex}, {"fabric_id": fabric, **QUICK}
    first = client.post("/v1/fabrics/search", json=body, headers=headers)
    client.delete(first.headers["location"])
    assert client.delete(f"/v1/fabrics/{fabric}").status_code == 204
    again = client.post("/v1/fabrics/search", json=body, headers=headers)
    assert (again.status_code, again.headers["location"]) == (202, first.headers["location"])
    assert client.post("/v1/fabrics/search", json=body).status_code == 404


def test_search_ranks_the_library_by_drape(client: httpx.Client) -> None:
    """On the tests' common server, whose worker has compiled already; others take back what they add."""
    answer = client.post("/v1/fabrics/search", json={"reference": STIFF, **QUICK})
    job = finished(client, answer.headers["location"])
    assert (job["status"], job["problem"]["code"]) == ("failed", "library_empty")
    limp = {**SOFT, "bending_warp": 2e-6, "bending_weft": 2e-6, "bending_bias": 2e-6}
    known = {"system": "windchill", "id": "SEARCHED-1", "revision": "A"}
    ids = [
        client.post("/v1/fabrics", json={"name": name, "parameters": parameters, "plm_ref": ref}).json()["id"]
        for name, parameters, ref in [("board", STIFF, None), ("soft", SOFT, known), ("limp", limp, None)]
    ]
    answer = client.post("/v1/fabrics/search", json={"fabric_id": ids[0], **QUICK})
    job = finished(client, answer.headers["location"])
    assert job["problem"] is None
    ranking = job["result"]["ranking"]
    assert {r["id"]: r["plm_ref"] for r in ranking} == {ids[1]: known, ids[2]: None}
    assert ranking[0]["distance"] <= ranking[1]["distance"]
    picture = client.get(job["files"][0]["url"])
    assert picture.content.startswith(b"\x89PNG")
    assert picture.headers["content-disposition"].startswith("attachment")
    assert client.get(f"{answer.headers['location']}/files/nothing.png").json()["code"] == "file_not_found"
    answer = client.post("/v1/fabrics/search", json={"reference": {**STIFF, "density": 0.21}, "limit": 1, **QUICK})
    job = finished(client, answer.headers["location"])
    assert [r["name"] for r in job["result"]["ranking"]] == ["board"]


def test_a_conflict_with_the_same_request_is_its_first_answer(database: Database) -> None:
    """The other of two alike was stored between the look for its answer and the look whether the reference is free."""

    def once(key: str | None) -> Once:
        return Once(database, EVERYBODY, key, fingerprint("fabrics", {"n": 1}), hours=24.0)

    first = once("k").answer(lambda session: Answer(201, {"id": "one"}))

    def taken(session: Session) -> Answer:
        raise ProblemError(409, "plm_ref_taken", "it is there")

    late = once("k")
    looks = iter([None])  # the first look finds nothing yet

    class Late(Once):
        def _replay(self, session: Session) -> JSONResponse | None:
            return next(looks, super()._replay(session))

    again = Late(late.database, late.caller, late.key, late.fingerprint, late.hours).answer(taken)
    assert (again.status_code, again.body) == (201, first.body) and again.headers["idempotent-replayed"] == "true"
    with pytest.raises(ProblemError) as caught:
        once(None).answer(taken)
    assert caught.value.code == "plm_ref_taken"
