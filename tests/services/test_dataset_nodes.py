"""Two Ray nodes as separate processes on the loopback; one is killed in mid-run."""

from __future__ import annotations

import os
import secrets
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from renderer.store import Store
from services.dataset.validation import validate_store
from tests.services.dataset_helpers import (
    COMMAND,
    SHARDS,
    SLOW,
    SLOW_M,
    assert_same_store,
    small_sweep,
    write_without_ray,
)
from tests.services.test_dataset_sweep import wait_for_shards

pytestmark = [pytest.mark.ray, pytest.mark.slow, pytest.mark.timeout(600)]

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


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


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


def wait_for_nodes(address: str, count: int) -> None:
    """Until the cluster has so many nodes."""
    status = [str(Path(sys.executable).with_name("ray")), "status", "--address", address]
    for _ in range(60):
        answer = subprocess.run(status, capture_output=True, text=True, check=False, env=os.environ | CLUSTER)
        if answer.stdout.count("1 node_") >= count:
            return
        time.sleep(1.0)
    raise AssertionError(f"{count} nodes did not come up: {answer.stdout} {answer.stderr}")


def scrape(port: int) -> dict[str, float]:
    """The sweep's own series at a node's Prometheus end point, added up over their labels."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as answer:
        lines = answer.read().decode().splitlines()
    found: dict[str, float] = defaultdict(float)
    for line in lines:
        if line.startswith("ray_drapemeter_"):
            found[line.split("{")[0].removeprefix("ray_")] += float(line.split()[-1])
    return found


def wait_for_metric(port: int, name: str, process: subprocess.Popen[bytes]) -> dict[str, float]:
    """Until a series is served; all of them."""
    found: dict[str, float] = {}
    while process.poll() is None:
        found = scrape(port)
        if found.get(name):
            return found
        time.sleep(0.2)
    raise AssertionError(f"{name} was not served while the sweep ran: {found}")


def test_a_node_killed_in_mid_run_loses_and_repeats_nothing(tmp_path: Path) -> None:
    store, address = tmp_path / "s.zarr", f"127.0.0.1:{free_port()}"
    undisturbed = write_without_ray(tmp_path / "undisturbed.zarr", *small_sweep(resolution_m=SLOW_M))
    client_port, metrics_port = free_port(), free_port()
    head_arguments = [
        "--head",
        f"--ray-client-server-port={client_port}",
        f"--port={address.split(':')[1]}",
        f"--metrics-export-port={metrics_port}",
        "--include-dashboard=false",
    ]
    with (
        ray_node(head_arguments, tmp_path / "head.log"),
        ray_node([f"--address={address}"], tmp_path / "second.log") as second,
    ):
        wait_for_nodes(address, 2)
        command = [*COMMAND, *SLOW, "--out", str(store), "--address", address, "--json"]
        with (tmp_path / "driver.log").open("w") as log:
            driver = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | CLUSTER)
        try:
            wait_for_shards(store, 2, driver)
            assert worker_titles(second.pid), "the second node was to have a worker"
            kill_node(second)
            done = Store.open(store).complete.sum()
            assert done < SHARDS, "the node was to be killed in mid-run"
            served = wait_for_metric(metrics_port, "drapemeter_shards_retried_total", driver)
            assert served["drapemeter_simulations_total"] >= 6 and served["drapemeter_shards_total"] >= 2
            assert driver.wait(timeout=300) == 0, (tmp_path / "driver.log").read_text()
        finally:
            driver.kill()
            driver.wait()
        (store / "checksum" / "c" / "3" / "0").unlink()
        through_client = [
            *COMMAND,
            *SLOW,
            "--out",
            str(store),
            "--address",
            f"ray://127.0.0.1:{client_port}",
            "--resume",
        ]
        resumed = subprocess.run(
            through_client, check=False, env=os.environ | CLUSTER, capture_output=True, text=True, timeout=300
        )
        assert resumed.returncode == 0, resumed.stderr + (tmp_path / "head.log").read_text()
    assert_same_store(undisturbed, store)
    assert validate_store(Store.open(store)).valid


def worker_titles(pid: int) -> list[str]:
    """Titles of the shard workers among a process's descendants."""
    lines = [" ".join(child.cmdline()) for child in psutil.Process(pid).children(recursive=True)]
    return [line for line in lines if "ShardWorker" in line]
