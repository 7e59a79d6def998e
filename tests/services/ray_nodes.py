"""Ray nodes as separate processes on the loopback."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

CLUSTER = {
    "RAY_AUTH_MODE": "token",
    "RAY_AUTH_TOKEN": secrets.token_hex(32),
    "RAY_health_check_period_ms": "500",
    "RAY_health_check_initial_delay_ms": "1000",
    "RAY_health_check_failure_threshold": "6",
    "RAY_metrics_report_interval_ms": "500",
    "RAY_USAGE_STATS_ENABLED": "0",
}
START = [str(Path(sys.executable).with_name("ray")), "start", "--block", "--num-cpus=1", "--disable-usage-stats"]
START += ["--object-store-memory=100000000", "--node-ip-address=127.0.0.1"]


@contextmanager
def ray_node(arguments: list[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """`ray start` until the end of the block, in a session of its own; all it started ends with it."""
    with log.open("w") as out:
        process = subprocess.Popen(
            [*START, *arguments], stdout=out, stderr=out, env=os.environ | CLUSTER, start_new_session=True
        )
    try:
        yield process
    finally:
        kill_node(process)


def kill_node(process: subprocess.Popen[bytes]) -> None:
    """SIGKILL for a node's every process, workers included."""
    family = [process.pid]
    if process.poll() is None:
        family += [child.pid for child in psutil.Process(process.pid).children(recursive=True)]
    for pid in family:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
    process.wait()


def head_node(port: int, *arguments: str) -> list[str]:
    """Options of the first node of a cluster."""
    return ["--head", f"--port={port}", "--include-dashboard=false", *arguments]


def wait_for_nodes(address: str, *nodes: subprocess.Popen[bytes]) -> None:
    """Until all of a cluster's nodes are there."""
    status = [str(Path(sys.executable).with_name("ray")), "status", "--address", address]
    for _ in range(60):
        answer = subprocess.run(status, capture_output=True, text=True, check=False, env=os.environ | CLUSTER)
        if answer.stdout.count("1 node_") >= len(nodes):
            return
        ended = [node.returncode for node in nodes if node.poll() is not None]
        assert not ended, f"nodes ended with {ended}: see their logs"
        time.sleep(1.0)
    raise AssertionError(f"{len(nodes)} nodes did not come up: {answer.stdout} {answer.stderr}")


def at_work(node: subprocess.Popen[bytes], title: str) -> bool:
    """Whether a worker of this node has a title that says so: Ray names them by actor or task."""
    for child in psutil.Process(node.pid).children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # it ended since
            if title in " ".join(child.cmdline()):
                return True
    return False
