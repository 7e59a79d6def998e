"""A disk that is full in earnest: a file system of its own, too small for the sweep."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from renderer.store import Store
from services.dataset.validation import validate_store
from tests.services.dataset_helpers import COMMAND, SHARDS, assert_same_store, small_sweep, write_without_ray

pytestmark = [pytest.mark.ray, pytest.mark.slow, pytest.mark.timeout(600)]

ROOM_KB = 700
"""About half of what the sweep's store takes."""


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system in memory; only root may mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={ROOM_KB}k", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("this user may not mount a file system")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_is_one_line_and_a_resumed_sweep_is_the_undisturbed_one(small_disk: Path, tmp_path: Path) -> None:
    store = small_disk / "s.zarr"
    command = [*COMMAND, "--out", str(store), "--json"]
    stopped = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    told = stopped.stderr.strip().splitlines()
    lines = [line for line in told if " of 20 simulations, " not in line]  # a long sweep tells its progress in between
    assert stopped.returncode == 1, stopped.stderr
    assert len(lines) == 2 and "core hours" in lines[0], f"the cost, then the fault: {told}"
    assert lines[-1].endswith("[store_no_space]") and "--resume" in lines[-1]
    done = Store.open(store).complete.sum()
    assert 0 < done < SHARDS, "the disk was to fill in mid-run"
    subprocess.run(["mount", "-o", "remount,size=20m", str(small_disk)], check=True)
    subprocess.run([*command, "--resume"], check=True, capture_output=True, timeout=300)
    assert_same_store(write_without_ray(tmp_path / "undisturbed.zarr", *small_sweep()), store)
    assert validate_store(Store.open(store)).valid
