"""An atlas built by two Ray nodes that share no folder; one is killed in mid-run."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import pytest

from capture.capture_set import CaptureSet
from diagnosis.atlas import build_atlas
from diagnosis.atlas_part import atlas_parts
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.synthesis import SynthesisPlan, make_capture_set
from tests.services.dataset_helpers import PROGRAM
from tests.services.ports import free_port
from tests.services.ray_nodes import CLUSTER, at_work, head_node, kill_node, ray_node, wait_for_nodes
from tests.services.test_atlas_ray import assert_same_atlas

pytestmark = [pytest.mark.ray, pytest.mark.slow, pytest.mark.timeout(600)]

EFFECTS, RESOLUTION_M = ("air_draft", "depth_scale"), 0.025
PLAN = SynthesisPlan(fabrics=2, scenes=("stretch",), repeats=1, resolution_m=0.05, seed=3, pin_radius_m=0.0)


def build(captures: CaptureSet, folder: Path, address: str) -> list[str]:
    """The command line."""
    wanted = ["--effects", ",".join(EFFECTS), "--resolution", str(RESOLUTION_M), "--out", str(folder / "report")]
    atlas = ["--build-atlas", "--atlas", str(folder / "atlas"), "--address", address, "--json"]
    return [*PROGRAM, "diagnose", str(captures.folder), *wanted, *atlas]


def wait_for_a_part(drapes: Path, node: subprocess.Popen[bytes], driver: subprocess.Popen[bytes]) -> None:
    """Until something is kept and the node is at work."""
    while driver.poll() is None:
        if any(drapes.rglob("*.npz")) and at_work(node, "_solve_apart"):
            return
        time.sleep(0.1)
    raise AssertionError("the atlas was whole before both nodes had a part")


def test_nodes_keep_what_one_process_keeps_though_one_is_killed(tmp_path: Path) -> None:
    captures = make_capture_set(tmp_path / "set", PLAN, [])
    parts = atlas_parts(captures, EFFECTS, RESOLUTION_M)
    drapes = tmp_path / "atlas" / "drapes"
    here, there = DrapeCache(tmp_path / "here"), DrapeCache(drapes)
    build_atlas(parts[:1], here)
    first_part = list(here.files())
    build_atlas(parts, here)
    port, client_port = free_port(), free_port()
    head = head_node(port, f"--ray-client-server-port={client_port}")
    with (
        ray_node(head, tmp_path / "head.log") as first,
        ray_node([f"--address=127.0.0.1:{port}"], tmp_path / "second.log") as second,
    ):
        wait_for_nodes(f"127.0.0.1:{port}", first, second)
        with (tmp_path / "driver.log").open("w") as log:
            command = build(captures, tmp_path, f"127.0.0.1:{port}")
            driver = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | CLUSTER)
        try:
            wait_for_a_part(drapes, second, driver)
            kill_node(second)
            assert not all(part.is_ready(there) for part in parts), "the node was to be killed in mid-run"
            assert driver.wait(timeout=300) == 0, (tmp_path / "driver.log").read_text()
        finally:
            driver.kill()
            driver.wait()
        assert_same_atlas(here, there)
        for name in first_part:
            (drapes / name).unlink()
        command = build(captures, tmp_path, f"ray://127.0.0.1:{client_port}")
        again = subprocess.run(
            command, check=False, env=os.environ | CLUSTER, capture_output=True, text=True, timeout=300
        )
        assert again.returncode == 0, again.stderr + (tmp_path / "head.log").read_text()
    assert_same_atlas(here, there)
