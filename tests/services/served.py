"""A real `drapemeter serve` on a loopback port, for tests."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import psutil

COMMAND = [sys.executable, "-c", "from services.cli.main import main; main()"]
STIFF = {
    "stretch_warp": 3000.0,
    "stretch_weft": 3000.0,
    "stretch_bias": 3000.0,
    "bending_warp": 1e-3,
    "bending_weft": 1e-3,
    "bending_bias": 1e-3,
    "density": 0.2,
}
SOFT = {**STIFF, "bending_warp": 1e-5, "bending_weft": 1e-5, "bending_bias": 1e-5}
QUICK = {"backend": "depth", "simulations": 1, "resolution_m": 0.05}
"""The coarsest comparison: fractions of a second a simulation."""


@dataclass
class Served:
    """A running server."""

    process: subprocess.Popen[str]
    database: str
    lines: list[dict[str, Any]] = field(default_factory=list)

    def log(self, event: str, timeout_s: float = 60.0) -> dict[str, Any]:
        """The first log line of an event, waited for."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            for line in list(self.lines):
                if str(line.get("event", "")).startswith(event):
                    return line
            if self.process.poll() is not None and not self._reader.is_alive():
                break
            time.sleep(0.02)
        raise AssertionError(f"no {event!r} in {self.lines}")

    def follow(self) -> None:
        """Read the log in a thread, so that the pipe never fills."""

        def read() -> None:
            assert self.process.stderr is not None
            for text in self.process.stderr:
                try:
                    self.lines.append(json.loads(text))
                except ValueError:
                    self.lines.append({"event": text.rstrip()})

        self._reader = threading.Thread(target=read, daemon=True)
        self._reader.start()

    @property
    def url(self) -> str:
        """Where it listens."""
        return str(self.log("listening")["url"])

    def client(self, **options: Any) -> httpx.Client:
        """A client of it."""
        return httpx.Client(base_url=self.url, timeout=180, **options)

    def stop(self) -> int:
        """SIGTERM and the exit status."""
        self.process.terminate()
        try:
            return self.process.wait(30)
        except subprocess.TimeoutExpired:
            for child in [*psutil.Process(self.process.pid).children(recursive=True), self.process]:
                child.kill()
            self.process.wait()
            raise


def environment(folder: Path, **settings: str) -> dict[str, str]:
    """The tests' own settings, whatever the shell has."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("DRAPEMETER_")}
    own = {
        "OMP_NUM_THREADS": "1",
        "DRAPEMETER_CACHE": str(folder / "cache"),
        "DRAPEMETER_DATABASE": f"sqlite:///{folder}/service.db",
        "DRAPEMETER_DATASET_ROOT": str(folder / "datasets"),
        "DRAPEMETER_JOB_LEASE_S": "2",
        "DRAPEMETER_JOB_SHUTDOWN_GRACE_S": "0.5",
        "DRAPEMETER_ESTIMATE_TIMEOUT_S": "170",
    }
    return {**kept, **own, **settings}


@contextmanager
def serving(folder: Path, *options: str, **settings: str) -> Iterator[Served]:
    """`drapemeter serve` in a folder of its own, ended with the block."""
    env = environment(folder, **settings)
    process = subprocess.Popen(
        [*COMMAND, "serve", "--port", "0", *options],
        env=env,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE if "--json" in options else subprocess.DEVNULL,
        text=True,
    )
    served = Served(process, env["DRAPEMETER_DATABASE"])
    served.follow()
    try:
        yield served
    finally:
        if process.poll() is None:
            served.stop()


def drapemeter(folder: Path, *arguments: str, **settings: str) -> subprocess.CompletedProcess[str]:
    """Another command on the same database."""
    env = environment(folder, **settings)
    return subprocess.run([*COMMAND, *arguments], env=env, capture_output=True, text=True, timeout=120, check=False)


def finished(client: httpx.Client, location: str, timeout_s: float = 300.0) -> dict[str, Any]:
    """A job's document once it has ended."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        job: dict[str, Any] = client.get(location).raise_for_status().json()
        if job["status"] not in {"queued", "running"}:
            return job
        time.sleep(0.1)
    raise AssertionError(f"the job has not ended: {job}")
