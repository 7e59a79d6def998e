"""A sweep small enough for tests: 50 mm cells, a tenth of a second a drape."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

from services.dataset.configuration import SweepConfiguration
from services.dataset.fabrics import FabricTable, plan_sweep
from services.dataset.shard import ShardTask
from services.dataset.sweep import prepare_store
from services.dataset.worker import ShardWorker, SimulationDone

Place = TypeVar("Place", Path, str)
PROGRAM = [sys.executable, "-c", "from services.cli.main import main; main()"]
SWEEP = "dataset --materials 10 --jitters 1 --inclinations 2 --resolution 0.05 --seed 4 --shard-simulations 3"
COMMAND = [*PROGRAM, *shlex.split(SWEEP), "--workers", "2"]
"""The command line of :func:`small_sweep`."""

SLOW_M = 0.025
SLOW = ["--resolution", str(SLOW_M)]
"""For the command line: half a second a drape, so that what happens in mid-run does."""

SHARDS = 7


def small_sweep(**settings: Any) -> tuple[SweepConfiguration, FabricTable]:
    """20 simulations in 7 shards, the last one shorter, unless settings say otherwise."""
    chosen: dict[str, Any] = {"materials": 10, "jitters": 1, "inclinations": 2, "simulations_per_shard": 3, "seed": 4}
    return plan_sweep(**(chosen | {"resolution_m": 0.05} | settings))


def write_without_ray(place: Place, configuration: SweepConfiguration, fabrics: FabricTable) -> Place:
    """The store of a sweep, made in this process by one worker, shard after shard."""
    work_off(str(place), configuration, fabrics, prepare_store(str(place), configuration, resume=False))
    return place


def work_off(url: str, configuration: SweepConfiguration, fabrics: FabricTable, shards: Iterable[int]) -> None:
    """Write some shards of a store in this process."""
    worker = ShardWorker(url, configuration)
    layout = configuration.layout
    for shard in shards:
        materials = [layout.address(number)[0] for number in layout.shard_simulations(shard)]
        list(worker.run(ShardTask(shard, fabrics.parameters(materials), {})))


def told(worker: ShardWorker, task: ShardTask) -> list[SimulationDone]:
    """What a worker says of the simulations of one shard."""
    return [word for word in worker.run(task) if isinstance(word, SimulationDone)]


def files(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, by its path in it."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def assert_same_store(one: Path, other: Path) -> None:
    """Equal bit for bit, file for file."""
    a, b = files(one), files(other)
    assert sorted(a) == sorted(b)
    assert [name for name in a if a[name] != b[name]] == []
