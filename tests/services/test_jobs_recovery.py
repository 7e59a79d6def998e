"""Real processes that are killed: the job is run again and ends, nothing is left behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from pathlib import Path

import httpx
import psutil
import pytest
from sqlalchemy import select

from services.db.engine import Database
from services.db.jobs import Job, JobStatus, Worker
from services.jobs.queue import enqueue, request_cancel
from services.jobs.scratch import PREFIX
from services.settings import Settings
from tests.services.job_functions import work_slowly
from tests.services.job_rows import read_job
from tests.services.served import COMMAND, QUICK, SOFT, STIFF, Served, environment, finished, serving


@contextmanager
def worker(database: Database, **more: float) -> Iterator[BaseProcess]:
    """A real worker process with a real child, whose jobs only count."""
    values = {"job_lease_s": 1.0, "job_shutdown_grace_s": 0.2, **more}
    settings = Settings.model_validate({"database": str(database.url), **values})
    process = multiprocessing.get_context("spawn").Process(target=work_slowly, args=(settings,))
    process.start()
    try:
        yield process
    finally:
        process.terminate()
        process.join(20)
        assert not process.is_alive()


def add(database: Database, folder: Path, seconds: float) -> str:
    with database.write() as session:
        return enqueue(session, "drape_distance", {"folder": str(folder), "seconds": seconds}).id


def wait(database: Database, job_id: str, until: Callable[[Job], bool], timeout_s: float = 90.0) -> Job:
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        job = read_job(database, job_id)
        if until(job):
            return job
        time.sleep(0.05)
    raise AssertionError(f"{job.status} {job.progress} {job.problem}")


def at_work(job: Job) -> bool:
    return job.status == JobStatus.RUNNING and job.progress > 0


def ended(job: Job) -> bool:
    return JobStatus(job.status).final


def alive(folder: Path) -> list[int]:
    """Children that worked on the folder and still live."""
    found = [int(path.name.removeprefix("process-")) for path in folder.glob("process-*")]
    return [pid for pid in found if psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE]


def test_a_job_whose_worker_is_killed_goes_to_the_next_worker(
    database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    job_id = add(database, tmp_path, 3.0)
    with worker(database) as first:
        wait(database, job_id, at_work)
        assert first.pid is not None
        os.kill(first.pid, signal.SIGKILL)
        first.join()
        (left,) = tmp_path.glob(f"{PREFIX}*")
    with worker(database):
        job = wait(database, job_id, ended)
    assert not left.exists()
    assert (job.status, job.attempts, job.result) == ("succeeded", 2, {"counted": 10})
    assert len(list(tmp_path.glob("process-*"))) == 2
    assert not alive(tmp_path)


def test_a_job_whose_own_process_is_killed_is_run_again(database: Database, tmp_path: Path) -> None:
    job_id = add(database, tmp_path, 2.0)
    with worker(database):
        wait(database, job_id, at_work)
        (pid,) = alive(tmp_path)
        os.kill(pid, signal.SIGKILL)
        job = wait(database, job_id, ended)
    assert (job.status, job.attempts) == ("succeeded", 2)


def test_sigterm_gives_the_job_back_without_losing_an_attempt(database: Database, tmp_path: Path) -> None:
    job_id = add(database, tmp_path, 4.0)
    with worker(database):
        wait(database, job_id, at_work)
    job = read_job(database, job_id)
    assert (job.status, job.attempts, job.progress) == ("queued", 0, 0.0)
    assert not alive(tmp_path)


def test_sigterm_to_all_processes_at_once_gives_the_job_back_too(database: Database, tmp_path: Path) -> None:
    """As a service manager stops them."""
    job_id = add(database, tmp_path, 4.0)
    with worker(database) as first:
        wait(database, job_id, at_work)
        (pid,) = alive(tmp_path)
        assert first.pid is not None
        os.kill(first.pid, signal.SIGTERM)
        os.kill(pid, signal.SIGTERM)
    job = read_job(database, job_id)
    assert (job.status, job.attempts) == ("queued", 0)


def test_a_cancelled_job_is_stopped_in_the_middle(database: Database, tmp_path: Path) -> None:
    job_id = add(database, tmp_path, 600.0)
    with worker(database):
        wait(database, job_id, lambda job: job.status == JobStatus.RUNNING and bool(alive(tmp_path)))
        with database.write() as session:
            request_cancel(session, session.scalars(select(Job)).one())
        job = wait(database, job_id, ended)
        assert job.status == JobStatus.CANCELLED
        assert not alive(tmp_path)
        after = add(database, tmp_path, 0.1)
        assert wait(database, after, ended).status == JobStatus.SUCCEEDED


def test_a_job_over_its_time_is_stopped(database: Database, tmp_path: Path) -> None:
    job_id = add(database, tmp_path, 600.0)
    with worker(database, job_time_limit_s=3.0):
        job = wait(database, job_id, ended)
        assert job.problem is not None
        assert (job.status, job.problem["code"]) == ("failed", "job_timed_out")
        assert not alive(tmp_path)


def test_a_worker_alone_takes_the_jobs_of_a_server_without_workers(tmp_path: Path) -> None:
    with serving(tmp_path, "--workers", "0") as served, served.client() as client:
        body = {"reference": STIFF, **QUICK}  # ends at once: there is nothing to search
        location = client.post("/v1/fabrics/search", json=body).headers["location"]
        assert client.get("/readyz").json()["workers"] == 0
        with serving(tmp_path, "--worker-only") as alone:
            assert finished(client, location)["problem"]["code"] == "library_empty"
            assert client.get("/readyz").json()["workers"] == 1
            assert alone.stop() == 0
        assert client.get("/readyz").json()["workers"] == 0


def descendants(served: Served) -> list[psutil.Process]:
    return psutil.Process(served.process.pid).children(recursive=True)


def started(client: httpx.Client) -> str:
    """A real comparison that is at work."""
    body = {"a": STIFF, "b": SOFT, **QUICK, "simulations": 8}
    location = client.post("/v1/drape-distances", json=body).headers["location"]
    deadline = time.monotonic() + 120
    while client.get(location).json()["status"] != "running":
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return location


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_real_job_survives_the_kill_of_its_worker_and_of_its_server(tmp_path: Path) -> None:
    with serving(tmp_path) as served, served.client() as client:
        location = started(client)
        os.kill(int(str(served.log("worker_started")["worker"]).split("-")[-2]), signal.SIGKILL)
        assert served.log("worker_died")
        deadline = time.monotonic() + 60
        while sum(line.get("event") == "worker_started" for line in served.lines) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.1)
        left = descendants(served)
        assert left
        served.process.kill()
        served.process.wait()
        _, still = psutil.wait_procs(left, timeout=20)
        assert not still
    with serving(tmp_path) as served, served.client() as client:
        job = finished(client, location)
        assert job["problem"] is None
        assert served.stop() == 0


def test_workers_alone_are_as_many_as_asked_for_and_end_together(database: Database, tmp_path: Path) -> None:
    env = environment(tmp_path, DRAPEMETER_DATABASE=str(database.url))
    process = subprocess.Popen(
        [*COMMAND, "serve", "--worker-only", "--workers", "2"], env=env, stderr=subprocess.DEVNULL
    )
    try:
        deadline = time.monotonic() + 120
        alive: list[str] = []
        while len(alive) < 2 and time.monotonic() < deadline:
            time.sleep(0.1)
            with database.read() as session:
                alive = list(session.scalars(select(Worker.id)))
        assert len(alive) == 2
    finally:
        process.terminate()
    assert process.wait(60) == 0
    with database.read() as session:
        assert list(session.scalars(select(Worker.id))) == []
