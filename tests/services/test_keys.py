"""API keys: making, scopes, revoking, and when a server needs them."""

from __future__ import annotations

import json
import socket
import sqlite3
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from fastapi import Request
from sqlalchemy.exc import InternalError

from services.api.auth import NOTE_USE_EVERY, identify, refuse_browsers
from services.api.keys import create_key, find_key, list_keys, revoke_key
from services.api.problems import ProblemError
from services.api.scopes import ApiScope, parse_scopes
from services.cli import main
from services.db.base import utc_now
from services.db.engine import Database, parse_url
from services.settings import Settings
from simcore.errors import InputError
from tests.services.served import QUICK, STIFF, Served, drapemeter, serving


def prefix(token: str) -> str:
    """The part of a token that may be shown."""
    return "_".join(token.split("_", 2)[:2])


@pytest.mark.parametrize("name", ["", "x" * 81, "caf\udce9"])
def test_a_key_has_a_name_of_characters(database: Database, name: str) -> None:
    """What a terminal of another encoding hands over is none."""
    with database.write() as session, pytest.raises(InputError) as caught:
        create_key(session, name, (ApiScope.FABRICS_READ,))
    assert caught.value.code == "key_name"


def test_a_key_is_found_by_its_token_only(database: Database) -> None:
    with database.write() as session:
        key = create_key(session, "plm", (ApiScope.FABRICS_READ,))
    with database.read() as session:
        found = find_key(session, key.token)
        assert found is not None
        assert found.scopes == ["fabrics:read"]
        for wrong in (key.token[:-1] + ("A" if key.token[-1] != "A" else "B"), key.token[:-1], "", "dm_", key.id):
            assert find_key(session, wrong) is None


def test_the_secret_is_not_in_the_database(database: Database, tmp_path: Path) -> None:
    with database.write() as session:
        key = create_key(session, "plm", (ApiScope.FABRICS_READ,))
    secret = key.token.split("_", 2)[2]
    stored = [tuple(row) for row in sqlite3.connect(tmp_path / "test.db").execute("SELECT * FROM api_keys")]
    assert secret not in str(stored)
    assert len(secret) >= 43


def test_revoked_and_expired_keys_are_refused(database: Database) -> None:
    with database.write() as session:
        revoked = create_key(session, "a", tuple(ApiScope))
        expiring = create_key(session, "b", tuple(ApiScope), expires_after_days=1e-9)
        revoke_key(session, prefix(revoked.token))
    assert expiring.expires_at is not None
    assert expiring.expires_at <= utc_now()
    with database.read() as session:
        assert find_key(session, revoked.token) is None
        assert find_key(session, expiring.token) is None


def test_unknown_scopes_and_keys_are_refused(database: Database) -> None:
    for scopes, told in (
        ("fabrics:read,everything", "unknown scope 'everything'"),
        (" , ", "no scope"),
    ):
        with pytest.raises(InputError, match=rf"{told}.*: choose from .*fabrics:read.*, or \* for all") as caught:
            parse_scopes(scopes)
        assert caught.value.code == "scope_unknown"
    assert set(parse_scopes("*")) == set(ApiScope)
    with pytest.raises(InputError, match=r"^\* stands alone: [^:]*$") as caught:
        parse_scopes("fabrics:read,*")
    assert caught.value.code == "scope_unknown"
    with (
        database.write() as session,
        pytest.raises(InputError, match=r"no API key 'dm_unknown': .*keys list") as caught,
    ):
        revoke_key(session, "dm_unknown")
    assert caught.value.code == "key_unknown"


def test_what_is_no_text_is_no_key(database: Database) -> None:
    with (
        database.write() as session,
        pytest.raises(InputError, match=r"no API key '\\udcff': .*keys list") as caught,
    ):
        revoke_key(session, "\udcff")
    assert caught.value.code == "key_unknown"


@pytest.mark.parametrize("days", [0.0, -1.0, float("nan"), float("inf"), 36501.0])
def test_a_key_lives_for_some_days(database: Database, days: float) -> None:
    with database.write() as session:
        with pytest.raises(InputError, match="positive number of days") as caught:
            create_key(session, "plm", (ApiScope.FABRICS_READ,), expires_after_days=days)
        assert caught.value.code == "key_lifetime"
        assert list_keys(session) == []


def test_the_command_line_makes_lists_and_revokes(tmp_path: Path) -> None:
    made = drapemeter(tmp_path, "keys", "create", "--name", "plm", "--scopes", "fabrics:read", "--json")
    key = json.loads(made.stdout)
    assert key["token"].startswith("dm_")
    assert key["scopes"] == ["fabrics:read"]
    listed = json.loads(drapemeter(tmp_path, "keys", "list", "--json").stdout)
    assert [k["name"] for k in listed["keys"]] == ["plm"]
    assert key["token"] not in json.dumps(listed)
    revoked = drapemeter(tmp_path, "keys", "revoke", key["id"], "--json")
    assert json.loads(revoked.stdout) == {"id": key["id"], "revoked": True}
    refused = drapemeter(tmp_path, "keys", "create", "--name", "x", "--scopes", "all")
    assert refused.returncode == 2
    assert "unknown scope 'all'" in refused.stderr


def listed(url: str, capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, Any], str]:
    """The one key of a database, as a document and as a line of the table."""
    capsys.readouterr()
    said = []
    for form in (["--json"], []):
        assert main.run(["keys", "list", "--database", url, *form]) == 0
        said.append(capsys.readouterr().out)
    (key,) = json.loads(said[0])["keys"]
    return key, said[1].removesuffix("\n")


def test_use_and_revocation_are_listed(
    database: Database, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with database.write() as session:
        key = create_key(session, "plm", (ApiScope.FABRICS_READ, ApiScope.JOBS_READ))
    head = f"{prefix(key.token)}  plm"
    document, line = listed(database.public_url, capsys)
    assert document["last_used_at"] is None and document["revoked_at"] is None
    assert line == f"{head}  last used never  fabrics:read,jobs:read"

    def use() -> str:
        assert identify(with_key(key.token), guarded_state(database)).key_id == key.id
        document, line = listed(database.public_url, capsys)
        assert line == f"{head}  last used {document['last_used_at']}  fabrics:read,jobs:read"
        return str(document["last_used_at"])

    began = utc_now()
    first = use()
    assert began <= datetime.fromisoformat(first) <= utc_now()
    assert use() == first  # within a minute, so that not every request writes
    monkeypatch.setattr("services.api.auth.utc_now", lambda: utc_now() + NOTE_USE_EVERY)
    assert use() > first
    with pytest.raises(ProblemError):
        identify(with_key("dm_1f2e3d4c5b6a"), guarded_state(database))
    assert main.run(["keys", "revoke", key.id, "--database", database.public_url]) == 0
    document, line = listed(database.public_url, capsys)
    assert document["revoked_at"] >= document["last_used_at"] > first
    assert line == f"{head}  revoked  fabrics:read,jobs:read"


def with_key(token: str) -> Request:
    """Something that comes with a key."""
    return Request({"type": "http", "headers": [(b"authorization", f"Bearer {token}".encode())]})


def guarded_state(database: Database) -> Any:
    """All that is looked at of a server's state."""
    return SimpleNamespace(database=database, settings=Settings(environment="production"))


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Served, Path]]:
    """A server in production mode, which needs keys even on loopback."""
    folder = tmp_path_factory.mktemp("guarded")
    with serving(folder, "--workers", "0", DRAPEMETER_ENVIRONMENT="production") as running:
        running.log("Application startup complete")
        yield running, folder


def token(folder: Path, scopes: str) -> dict[str, str]:
    """A new key of the guarded server, as a header."""
    database = Database(f"sqlite:///{folder}/service.db")
    with database.write() as session:
        key = create_key(session, "test", parse_scopes(scopes))
    database.close()
    return {"Authorization": f"Bearer {key.token}"}


def test_without_a_valid_key_only_health_answers(guarded: tuple[Served, Path]) -> None:
    served, _ = guarded
    assert served.log("no_api_key")
    with served.client() as client:
        assert client.get("/healthz").status_code == client.get("/readyz").status_code == 200
        for path in ("/v1/fabrics", "/v1/jobs/job_x", "/metrics"):
            answer = client.get(path)
            assert (answer.status_code, answer.json()["code"]) == (401, "key_missing")
            assert answer.headers["www-authenticate"] == "Bearer"
        for wrong in ("Bearer dm_000000000000_" + "A" * 43, "Bearer x", "Basic eDp5"):
            answer = client.get("/v1/fabrics", headers={"Authorization": wrong})
            assert (answer.status_code, answer.json()["code"]) == (401, "key_invalid")


def test_a_key_does_what_its_scopes_say_and_no_more(guarded: tuple[Served, Path]) -> None:
    served, folder = guarded
    reader = token(folder, "fabrics:read")
    with served.client(headers=reader) as client:
        assert client.get("/v1/fabrics").status_code == 200
        answer = client.post("/v1/fabrics", json={"name": "x", "parameters": STIFF})
        assert (answer.status_code, answer.json()["code"]) == (403, "scope_missing")
        assert client.get("/metrics").status_code == 403


def test_every_route_asks_for_its_own_scope(guarded: tuple[Served, Path]) -> None:
    served, folder = guarded
    routes = {
        "estimates:write": [("POST", "/v1/estimates")],
        "distances:write": [("POST", "/v1/drape-distances")],
        "fabrics:read": [("GET", "/v1/fabrics"), ("GET", "/v1/fabrics/fab_x"), ("POST", "/v1/fabrics/search")],
        "fabrics:write": [("POST", "/v1/fabrics"), ("PUT", "/v1/fabrics/fab_x"), ("DELETE", "/v1/fabrics/fab_x")],
        "diagnoses:write": [("POST", "/v1/diagnoses")],
        "datasets:write": [("POST", "/v1/datasets")],
        "metrics:read": [("GET", "/metrics")],
    }
    assert {*routes, "jobs:read", "jobs:write"} == {scope.value for scope in ApiScope}
    with served.client() as client:
        for scope, asked in routes.items():
            others = token(folder, ",".join(sorted({s.value for s in ApiScope} - {scope})))
            for method, path in asked:
                answer = client.request(method, path, headers=others)
                assert (answer.status_code, answer.json()["code"]) == (403, "scope_missing"), (method, path)


def test_jobs_belong_to_the_key_that_made_them(guarded: tuple[Served, Path]) -> None:
    served, folder = guarded
    with served.client() as client:
        owner, stranger = token(folder, "distances:write"), token(folder, "distances:write")
        overseer = token(folder, "jobs:read")
        body = {"a": STIFF, "b": STIFF, **QUICK}
        location = client.post("/v1/drape-distances", json=body, headers=owner).headers["location"]
        assert client.get(location, headers=owner).status_code == 200
        assert client.get(location, headers=stranger).status_code == 404
        assert client.get(location, headers=overseer).status_code == 200
        assert client.delete(location, headers=overseer).status_code == 404
        assert client.delete(location, headers=owner).json()["status"] == "cancelled"


def test_idempotency_keys_of_different_callers_do_not_meet(guarded: tuple[Served, Path]) -> None:
    served, folder = guarded
    with served.client(headers={"Idempotency-Key": "shared"}) as client:
        ids = {
            client.post("/v1/fabrics", json={"name": n, "parameters": STIFF}, headers=token(folder, "*")).json()["id"]
            for n in ("one", "two")
        }
    assert len(ids) == 2


def test_a_revoked_key_stops_working_at_once(guarded: tuple[Served, Path]) -> None:
    served, folder = guarded
    headers = token(folder, "fabrics:read")
    with served.client(headers=headers) as client:
        assert client.get("/v1/fabrics").status_code == 200
        database = Database(f"sqlite:///{folder}/service.db")
        with database.write() as session:
            revoke_key(session, prefix(headers["Authorization"].split()[1]))
        database.close()
        assert client.get("/v1/fabrics").status_code == 401


def test_the_first_key_closes_an_open_server(tmp_path: Path) -> None:
    with serving(tmp_path, "--workers", "0", "--json") as running, running.client() as client:
        assert running.process.stdout is not None
        assert json.loads(running.process.stdout.readline()) == {"url": running.url}  # where a program finds it
        assert running.log("open_to_this_machine")
        assert client.get("/v1/fabrics").status_code == 200
        key = json.loads(drapemeter(tmp_path, "keys", "create", "--name", "a", "--json").stdout)
        assert client.get("/v1/fabrics").status_code == 401
        drapemeter(tmp_path, "keys", "revoke", key["id"])
        assert client.get("/v1/fabrics").status_code == 401  # revoking the last does not open it again
        assert httpx.get(f"{running.url}/healthz").status_code == 200


@pytest.mark.parametrize("password", ["", "postgres", "changeme", "drapemeter"])
def test_default_database_passwords_are_refused_when_others_can_come(password: str) -> None:
    url = f"postgresql://drapemeter:{password}@db/drapemeter"
    for open_to_others in ({"host": "0.0.0.0"}, {"environment": "production"}):
        with pytest.raises(InputError, match="well-known default: set a random one") as caught:
            Settings.model_validate({**open_to_others, "database": url}).require_safe()
        assert caught.value.code == "default_secret"
    Settings(database=url).require_safe()
    Settings(host="0.0.0.0", database="postgresql://drapemeter:sFwq29xVbn@db/drapemeter").require_safe()


def test_without_a_key_no_body_is_read(guarded: tuple[Served, Path]) -> None:
    """A stranger announces megabytes and never sends them: the answer does not wait for them."""
    served, _ = guarded
    host, port = served.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=20) as line:
        head = ["POST /v1/fabrics HTTP/1.1", "Host: x", "Content-Type: application/json", "Content-Length: 900000"]
        line.sendall("\r\n".join([*head, "", ""]).encode())
        assert line.recv(100).startswith(b"HTTP/1.1 401")


def test_a_long_body_that_is_no_upload_is_refused(guarded: tuple[Served, Path]) -> None:
    served, folder = guarded
    with served.client(headers=token(folder, "*")) as client:
        answer = client.post("/v1/fabrics", content=b"[" * 2_000_000, headers={"Content-Type": "application/json"})
        assert (answer.status_code, answer.json()["code"]) == (413, "request_too_large")


def test_a_database_that_refuses_is_one_line_without_its_statements(tmp_path: Path) -> None:
    drapemeter(tmp_path, "keys", "create", "--name", "first")
    (path,) = tmp_path.glob("*.db")
    with sqlite3.connect(path) as raw:
        raw.execute("drop table api_keys")
    made = drapemeter(tmp_path, "keys", "create", "--name", "second")
    said = made.stderr.strip().splitlines()
    assert made.returncode == 1
    assert len(said) == 1 and said[0].endswith("[database_unreachable]") and "INSERT" not in said[0]


def test_an_open_server_answers_this_machine_alone() -> None:
    def asked(host: str, **headers: str) -> Request:
        raw = [(b"host", host.encode()), *((n.replace("_", "-").encode(), v.encode()) for n, v in headers.items())]
        return Request({"type": "http", "headers": raw})

    for host in ("localhost:8000", "127.0.0.1", "127.0.0.2:80", "[::1]:8000"):
        refuse_browsers(asked(host))
        for passed_on in (
            {"x_forwarded_for": "203.0.113.9"},
            {"via": "1.1 p"},
            {"origin": "https://elsewhere.example"},
            {"origin": "http://["},
        ):
            with pytest.raises(ProblemError) as refused:
                refuse_browsers(asked(host, **passed_on))
            assert refused.value.code == "origin_refused"
    for host in ("elsewhere.example", "10.0.0.1:8000", ""):
        with pytest.raises(ProblemError):
            refuse_browsers(asked(host))


def test_keys_of_no_database_make_none(tmp_path: Path) -> None:
    for command in (("list",), ("revoke", "dm_1f2e3d4c5b6a")):
        answer = drapemeter(tmp_path, "keys", *command)
        assert answer.returncode == 2 and "[file_missing]" in answer.stderr
    assert not list(tmp_path.glob("*.db"))
    made = drapemeter(tmp_path, "keys", "create", "--name", "first")
    (place,) = tmp_path.glob("*.db")
    assert place.name in made.stderr and place.stat().st_mode & 0o077 == 0


def test_a_key_serves_while_the_database_only_reads(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    with database.write() as session:
        key = create_key(session, "plm", (ApiScope.FABRICS_READ,))

    def refuse(session: object, key_id: str) -> None:
        raise InternalError("UPDATE", {}, Exception("cannot execute UPDATE in a read-only transaction"))

    monkeypatch.setattr("services.api.auth.note_use", refuse)
    assert identify(with_key(key.token), guarded_state(database)).key_id == key.id


def test_an_expired_key_is_listed_as_such(tmp_path: Path) -> None:
    drapemeter(tmp_path, "keys", "create", "--name", "brief", "--expires-days", "1e-9")
    assert "  expired  " in drapemeter(tmp_path, "keys", "list").stdout


@pytest.mark.parametrize(
    "url", ["postgresql+psycopg2://u:p@h/db", "sqlite+aiosqlite:///x.db", "postgresql://u:p@h:port/db", "mysql://h/db"]
)
def test_databases_that_cannot_be_used_are_refused(url: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_url(url)
    assert caught.value.code == "database_url"
