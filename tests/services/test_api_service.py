"""The main path: real requests to a real server."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import uvicorn

from services.api import server
from services.api.inference import Inference
from services.api.server import _Server, open_listener, run_server
from services.cli import main
from services.db.engine import Database
from services.settings import Settings
from simcore.errors import InputError
from tests.services.served import QUICK, SOFT, STIFF, Served, drapemeter, finished

pytestmark = pytest.mark.timeout(400)
"""Of the first test that needs a worker, which compiles."""


def test_health_and_readiness_need_no_key(client: httpx.Client) -> None:
    assert client.get("/healthz").json() == {"status": "ok"}
    ready = client.get("/readyz")
    assert ready.status_code == 200
    assert ready.json()["database"] == "ok"
    assert ready.json()["model"] == "present"


def test_a_distance_job_is_polled_to_its_end(client: httpx.Client) -> None:
    answer = client.post("/v1/drape-distances", json={"a": STIFF, "b": SOFT, **QUICK})
    assert answer.status_code == 202
    assert int(answer.headers["retry-after"]) >= 1
    job = finished(client, answer.headers["location"])
    assert job["problem"] is None
    result = job["result"]
    assert result["distance"] > 0.001
    assert set(result["scenes"]) == {"hanging", "stretch"}
    assert (result["backend"], result["unit"], result["simulations"]) == ("depth", "m", 1)
    assert job["progress"] == 1.0


def test_the_same_idempotency_key_gives_the_same_job(client: httpx.Client) -> None:
    headers = {"Idempotency-Key": "once-and-only-once"}
    body = {"a": STIFF, "b": STIFF, **QUICK}
    first = client.post("/v1/drape-distances", json=body, headers=headers)
    again = client.post("/v1/drape-distances", json=dict(reversed(body.items())), headers=headers)
    assert (first.status_code, again.status_code) == (202, 202)
    assert again.headers["location"] == first.headers["location"]
    assert again.headers["idempotent-replayed"] == "true"
    other = client.post("/v1/drape-distances", json={**body, "seed": 5}, headers=headers)
    assert (other.status_code, other.json()["code"]) == (422, "idempotency_key_reused")
    client.delete(first.headers["location"])


def test_a_waiting_or_running_job_can_be_cancelled(client: httpx.Client) -> None:
    body = {"a": STIFF, "b": SOFT, **QUICK, "simulations": 100, "resolution_m": 0.01, "seed": 99}
    location = client.post("/v1/drape-distances", json=body).headers["location"]
    answer = client.delete(location)
    assert answer.status_code in {200, 202}
    assert finished(client, location)["status"] == "cancelled"
    assert client.delete(location).status_code == 200  # once more does no harm


def test_an_ended_job_cannot_be_cancelled(client: httpx.Client) -> None:
    location = client.post("/v1/drape-distances", json={"a": STIFF, "b": SOFT, **QUICK}).headers["location"]
    finished(client, location)
    answer = client.delete(location)
    assert (answer.status_code, answer.json()["code"]) == (409, "job_ended")


def test_metrics_count_requests_and_jobs(client: httpx.Client) -> None:
    client.get("/healthz")
    finished(client, client.post("/v1/drape-distances", json={"a": STIFF, "b": STIFF, **QUICK}).headers["location"])
    text = client.get("/metrics").text
    assert 'drapemeter_jobs{kind="drape_distance",status="succeeded"}' in text
    assert 'drapemeter_requests_total{method="GET",route="/healthz",status="200"}' in text


def test_each_answer_carries_a_request_id_that_the_log_has(client: httpx.Client, served: Served) -> None:
    answer = client.get("/healthz", headers={"X-Request-ID": "from-the-caller-1"})
    assert answer.headers["x-request-id"] == "from-the-caller-1"
    evil = client.get("/healthz", headers={"X-Request-ID": "a b\tc"})
    assert evil.headers["x-request-id"] != "a b\tc"
    assert any(line.get("request_id") == "from-the-caller-1" for line in served.lines)


@pytest.mark.parametrize("headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}])
def test_an_open_server_refuses_foreign_web_pages(client: httpx.Client, headers: dict[str, str]) -> None:
    answer = client.get("/v1/fabrics", headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "origin_refused")


@pytest.mark.parametrize("arguments", [("--worker-only",), ()])
def test_a_cache_that_cannot_be_made_is_told_before_anything_is_served(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("DRAPEMETER_CACHE", str(tmp_path / "file" / "cache"))
    database = tmp_path / "d.db"
    assert main.run(["serve", "--port", "0", "--database", f"sqlite:///{database}", *arguments]) == 2
    said = capsys.readouterr().err
    assert "set DRAPEMETER_CACHE to another folder" in said and said.endswith("[folder_unusable]\n")
    assert not database.exists()


def test_a_taken_port_is_told_in_one_line(served: Served, tmp_path: Path) -> None:
    port = served.url.rsplit(":", 1)[1]
    refused = drapemeter(tmp_path, "serve", "--port", port)
    assert refused.returncode == 2
    assert f"cannot listen at 127.0.0.1 port {port}" in refused.stderr
    assert refused.stderr.strip().splitlines()[-1].startswith("error:")


@pytest.mark.parametrize("host", ["a..b", "x" * 64, "\udcff"])
def test_what_is_no_name_of_a_host_is_told_in_one_line(host: str) -> None:
    with pytest.raises(InputError, match=r"cannot listen at .* \(no name of a host\): choose others") as caught:
        open_listener(host, 0)
    assert caught.value.code == "cannot_listen"


def test_workers_are_told_of_a_signal_while_requests_are_open() -> None:
    """The server itself waits for these."""
    asked: list[str] = []
    waiting = _Server(uvicorn.Config("no:app"), lambda: asked.append("to end"))
    waiting.handle_exit(signal.SIGTERM, None)
    assert asked == ["to end"] and waiting.should_exit and not waiting.force_exit


@pytest.fixture
def ended(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """What a server in this process has ended; it has no processes, and its handlers of signals go with the test."""
    found: list[str] = []

    class Workers:
        def __init__(self, settings: Settings) -> None:
            """No processes."""

        def start(self) -> None:
            found.append("begun")

        def close(self) -> None:
            found.append("workers")

    monkeypatch.setattr(server, "WorkerProcesses", Workers)
    monkeypatch.setattr(Inference, "close", lambda self: found.append("inference"))
    kept = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield found
    for number, handler in kept.items():
        signal.signal(number, handler)


def test_the_inference_process_ends_where_a_second_signal_cuts_the_end_short(
    ended: list[str], database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """uvicorn then leaves out the end of the application, and a process that nobody ends is waited for for ever."""
    monkeypatch.setattr(_Server, "run", lambda self, sockets: None)
    run_server(Settings(database=str(database.url), port=0))
    assert ended == ["begun", "inference", "workers"]


def test_workers_end_where_nobody_takes_the_address(ended: list[str], database: Database) -> None:
    def leave(url: str) -> None:
        raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        run_server(Settings(database=str(database.url), port=0), leave)
    assert ended == ["begun", "inference", "workers"]
