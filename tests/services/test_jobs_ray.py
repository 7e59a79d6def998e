"""Jobs whose simulations run on a Ray cluster."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.services.ports import free_port
from tests.services.ray_nodes import CLUSTER, head_node, ray_node, wait_for_nodes
from tests.services.served import QUICK, SOFT, STIFF, finished, serving


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[str]:
    """Address of a cluster of one node with one core, processes of its own."""
    port = free_port()
    folder = tempfile.mkdtemp(prefix="dm-ray-")  # short: sockets lie in it
    try:
        with ray_node(head_node(port, f"--temp-dir={folder}"), tmp_path / "ray.log") as node:
            wait_for_nodes(f"127.0.0.1:{port}", node)
            yield f"127.0.0.1:{port}"
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.ray
def test_a_distance_computed_on_a_cluster_is_the_one_computed_here(cluster: str, tmp_path: Path) -> None:
    body = {"a": STIFF, "b": SOFT, **QUICK}
    results = []
    for options in (("--ray-address", cluster), ()):
        folder = tmp_path / f"with-{len(options)}"
        folder.mkdir()
        with serving(folder, *options, **CLUSTER) as running, running.client() as client:
            job = finished(client, client.post("/v1/drape-distances", json=body).headers["location"])
        assert job["problem"] is None
        results.append(job["result"])
    assert results[0] == results[1]


@pytest.mark.timeout(400)
def test_a_cluster_that_does_not_answer_fails_the_job_with_a_code(tmp_path: Path) -> None:
    patience = {"DRAPEMETER_JOB_CLUSTER_PATIENCE_S": "0"}
    with serving(tmp_path, "--ray-address", "127.0.0.1:1", **patience) as running, running.client() as client:
        answer = client.post("/v1/drape-distances", json={"a": STIFF, "b": SOFT, **QUICK})
        job = finished(client, answer.headers["location"])
    assert (job["status"], job["problem"]["code"]) == ("failed", "cluster_missing"), job
