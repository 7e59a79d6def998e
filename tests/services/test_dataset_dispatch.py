"""The driver's loop with workers that die, hang, fill the disk or grow old."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.dataset.cluster import ray_cluster
from services.dataset.configuration import SweepConfiguration
from services.dataset.dispatch import Dispatcher, DispatchOptions
from services.dataset.solver_kind import SolverKind
from services.dataset.spread import spread
from services.dataset.worker import SimulationDone
from simcore.errors import InputError, StoreError
from tests.services.dataset_helpers import SHARDS, small_sweep
from tests.services.dataset_stub_workers import (
    DyingStoreWorker,
    DyingTogetherWorker,
    DyingWorker,
    FaultyWorker,
    FullDiskWorker,
    HangingWorker,
    ObedientWorker,
    SlowStoreWorker,
    refuse,
)

pytestmark = pytest.mark.ray
CONFIGURATION, FABRICS = small_sweep(time_limit_s=0.5)


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[int]:
    """Two workers' worth of Ray on this machine."""
    with ray_cluster("local", 2) as workers:
        yield workers


def dispatch(
    folder: Path,
    worker_class: type[ObedientWorker],
    configuration: SweepConfiguration = CONFIGURATION,
    **options: float,
) -> list[SimulationDone]:
    """Run all shards; what was heard."""
    heard: list[SimulationDone] = []
    chosen = DispatchOptions(workers=2, **options)  # type: ignore[arg-type]  # whole numbers where they are wanted
    Dispatcher(str(folder), configuration, FABRICS, chosen, heard.append, worker_class).run(range(SHARDS))
    return heard


def shards(folder: Path) -> dict[int, str]:
    """What the finished shards hold."""
    return {int(path.name): path.read_text() for path in folder.iterdir() if path.name.isdigit()}


def test_all_shards_are_done_once_and_old_workers_replaced(tmp_path: Path) -> None:
    heard = dispatch(tmp_path, ObedientWorker, recycle_after=5)
    assert sorted(word.simulation for word in heard) == list(range(20))
    assert len(shards(tmp_path)) == SHARDS
    assert max(word.solves for word in heard) == 6, "replaced after the shard in which the fifth solve falls"
    assert len({word.process_id for word in heard}) >= 4


def test_a_simulation_that_keeps_killing_is_given_up_and_the_others_kept(tmp_path: Path) -> None:
    dispatch(tmp_path, DyingWorker)
    assert shards(tmp_path) == dict.fromkeys(range(6), "ok ok ok") | {1: "ok crashed ok", 6: "ok ok"}


def test_workers_that_die_solving_a_shard_together_are_charged_to_the_simulation_that_kills(tmp_path: Path) -> None:
    together = CONFIGURATION.model_copy(update={"solver": SolverKind.BATCH})
    dispatch(tmp_path, DyingTogetherWorker, together)
    assert shards(tmp_path) == dict.fromkeys(range(6), "ok ok ok") | {1: "ok crashed ok", 6: "ok ok"}


def test_a_hung_simulation_is_ended_and_told(tmp_path: Path) -> None:
    dispatch(tmp_path, HangingWorker, silence_factor=1.0, compile_allowance_s=20.0)
    assert shards(tmp_path)[2] == "ok timed_out ok" and len(shards(tmp_path)) == SHARDS


@pytest.mark.parametrize("worker", [SlowStoreWorker, DyingStoreWorker])
def test_a_store_that_is_slow_or_kills_is_no_simulations_fault(tmp_path: Path, worker: type) -> None:
    """Fifteen seconds are more than a simulation may be silent for."""
    dispatch(tmp_path, worker, silence_factor=0.1, compile_allowance_s=0.0)
    assert shards(tmp_path) == dict.fromkeys(range(6), "ok ok ok") | {6: "ok ok"}


def test_a_full_disk_ends_the_sweep_with_its_own_line(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no space") as raised:
        dispatch(tmp_path, FullDiskWorker)
    assert raised.value.code == "store_no_space"
    assert 2 not in shards(tmp_path)


def test_a_fault_of_the_program_is_told_as_it_is(tmp_path: Path) -> None:
    with pytest.raises(KeyError, match="a fault of the program"):
        dispatch(tmp_path, FaultyWorker)


def test_what_a_piece_of_work_says_is_told_with_its_code() -> None:
    """And without the traceback of another process."""
    with pytest.raises(InputError, match=r"^1 is refused$") as raised:
        list(spread(refuse, [1], 2))
    assert raised.value.code == "refused_here"


def test_the_driver_and_rays_client_server_need_no_taichi() -> None:
    """Ray's client server imports what it passes on, and its process does not survive Taichi's library."""
    program = "import sys, services.dataset.drive; sys.exit(len({'taichi', 'open3d', 'torch'} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
