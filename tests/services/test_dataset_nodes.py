"""Two Ray nodes as separate processes on the loopback; one is killed in mid-run."""

from __future__ import annotations

import os
import subprocess
import time
import urllib.request
from collections import defaultdict
from pathlib import Path

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
from tests.services.ports import free_port
from tests.services.ray_nodes import CLUSTER, at_work, head_node, kill_node, ray_node, wait_for_nodes
from tests.services.test_dataset_sweep import wait_for_shards

pytestmark = [pytest.mark.ray, pytest.mark.slow, pytest.mark.timeout(600)]


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
    store, port = tmp_path / "s.zarr", free_port()
    address = f"127.0.0.1:{port}"
    undisturbed = write_without_ray(tmp_path / "undisturbed.zarr", *small_sweep(resolution_m=SLOW_M))
    client_port, metrics_port = free_port(), free_port()
    head = head_node(port, f"--ray-client-server-port={client_port}", f"--metrics-export-port={metrics_port}")
    with (
        ray_node(head, tmp_path / "head.log") as first,
        ray_node([f"--address={address}"], tmp_path / "second.log") as second,
    ):
        wait_for_nodes(address, first, second)
        command = [*COMMAND, *SLOW, "--out", str(store), "--address", address, "--json"]
        with (tmp_path / "driver.log").open("w") as log:
            driver = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | CLUSTER)
        try:
            wait_for_shards(store, 2, driver)
            assert at_work(second, "ShardWorker"), "the second node was to have a worker"
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
