"""Sweeps on real Ray: complete, the same bits however they were spread, interrupted and resumed."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from renderer.store import Store
from services.dataset.sweep import LEFT_OVER_S, _remove_leftovers, run_sweep
from services.dataset.validation import validate_store
from services.dataset.worker import SimulationDone
from tests.services.dataset_helpers import (
    COMMAND,
    SHARDS,
    SLOW,
    SLOW_M,
    assert_same_store,
    small_sweep,
    write_without_ray,
)

pytestmark = [pytest.mark.ray, pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small sweep's store, made without Ray by one worker."""
    return write_without_ray(tmp_path_factory.mktemp("undisturbed") / "store.zarr", *small_sweep())


@pytest.fixture(scope="module")
def undisturbed_slow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same on finer meshes, which leave time to end a run in its middle."""
    return write_without_ray(tmp_path_factory.mktemp("slow") / "store.zarr", *small_sweep(resolution_m=SLOW_M))


def test_two_workers_give_the_bits_of_one_and_survive_a_kill(undisturbed: Path, tmp_path: Path) -> None:
    heard: list[SimulationDone] = []

    def kill_once(word: SimulationDone) -> None:
        """The first one waits until another one was killed and replaced: however slowly they come up, both get work."""
        new = word.process_id not in {one.process_id for one in heard}
        heard.append(word)
        processes = list(dict.fromkeys(one.process_id for one in heard))
        if new and len(processes) <= 3:
            what = (signal.SIGSTOP, signal.SIGKILL, signal.SIGCONT)[len(processes) - 1]
            os.kill(processes[1] if what == signal.SIGKILL else processes[0], what)

    configuration, fabrics = small_sweep()
    summary = run_sweep(tmp_path / "s.zarr", configuration, fabrics, workers=2, listen=kill_once)
    assert (summary.samples, summary.failed) == (40, {})
    assert_same_store(undisturbed, tmp_path / "s.zarr")
    assert validate_store(Store.open(tmp_path / "s.zarr")).valid
    assert len({word.process_id for word in heard}) == 3, "two workers, one of them replaced"


@pytest.mark.parametrize(("end", "exit_code"), [(signal.SIGKILL, -9), (signal.SIGINT, 130)])
def test_driver_ended_and_resumed_gives_the_undisturbed_store(
    end: signal.Signals, exit_code: int, undisturbed_slow: Path, tmp_path: Path
) -> None:
    store = tmp_path / "s.zarr"
    command = [*COMMAND, *SLOW, "--out", str(store), "--json"]
    with (tmp_path / "log").open("w") as log:
        driver = subprocess.Popen(command, stdout=log, stderr=log, preexec_fn=_heed_interrupts)
    try:
        wait_for_shards(store, 2, driver)
        driver.send_signal(end)
        assert driver.wait(timeout=60) == exit_code
    finally:
        driver.kill()
        driver.wait()
    assert ("--resume" in (tmp_path / "log").read_text()) == (end == signal.SIGINT)
    done = Store.open(store).complete.sum()
    assert 2 <= done < SHARDS, "the driver was to be ended in mid-run"
    subprocess.run([*command, "--resume"], check=True, capture_output=True, timeout=300)
    assert_same_store(undisturbed_slow, store)
    assert validate_store(Store.open(store)).valid


def _heed_interrupts() -> None:
    """A shell that runs the tests in the background has its children ignore Ctrl-C; the driver shall not."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def wait_for_shards(store: Path, count: int, process: subprocess.Popen[bytes]) -> None:
    """Until so many shards are marked complete."""
    for _ in range(1200):
        if len(list((store / "checksum" / "c").glob("*/0"))) >= count:
            return
        assert process.poll() is None, "the sweep ended by itself"
        time.sleep(0.1)
    raise AssertionError("no shard was finished in two minutes")


def test_what_another_driver_writes_just_now_is_no_leftover(tmp_path: Path) -> None:
    old, new = tmp_path / "zarr.0a1b.partial", tmp_path / "zarr.2c3d.partial"
    for path in (old, new):
        path.touch()
    os.utime(old, (long_ago := time.time() - LEFT_OVER_S - 1.0, long_ago))
    _remove_leftovers(tmp_path)
    assert list(tmp_path.iterdir()) == [new]
