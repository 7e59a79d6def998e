"""What the dataset service costs over bare simulation and rendering, how it scales, and what its stores weigh.

    python bench/bench_dataset.py [--materials 12] [--resolution 0.01] [--tasks 1000] [--json x.json] [--figure x.png]
    python bench/bench_dataset.py --costs 0.05,0.02,0.01,0.005 --materials 6

Prints a table and writes JSON. ``--costs`` instead sets simulations of several meshes beside what
:mod:`services.dataset.cost` expects of them. CPU seconds are those of every process of the service (driver, Ray,
workers) between the first and the last word of a worker; the overhead is what of them is not spent in solving and
rendering, both counted in one run, so that it holds on a busy machine too. Wall-clock numbers need a quiet one
(``RAY_worker_niceness=0`` gives Ray's workers the priority of everything else).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from results import add_json_option

from renderer.store import RowStatus, Store
from services.dataset.cluster import ray_cluster
from services.dataset.configuration import SweepConfiguration, simulation_seed
from services.dataset.cost import estimate_cost
from services.dataset.dispatch import Dispatcher, DispatchOptions
from services.dataset.fabrics import FabricTable, plan_sweep
from services.dataset.inspection import inspect_store
from services.dataset.shard import Outcome, ShardTask, simulate_and_render
from services.dataset.sweep import prepare_store, run_sweep
from services.dataset.worker import ShardWorker, SimulationDone
from simcore.solver import Solver


@dataclass(frozen=True)
class Run:
    """Time per simulation [s], how long until the first was done, the CPU time of solving and rendering alone, and the
    share of the time in which workers computed or waited for a core, and not for the driver or the store.
    """

    wall_s: float
    cpu_s: float
    start_s: float
    work_s: float
    busy: float = 1.0


def family_cpu_s() -> float:
    """CPU seconds of this process and all below it."""
    total = 0.0
    me = psutil.Process()
    for process in [me, *me.children(recursive=True)]:
        try:
            times = process.cpu_times()
        except psutil.NoSuchProcess:
            continue
        total += times.user + times.system
    return total


def wanted_core_s(process_id: int) -> float:
    """Seconds for which a process's main thread ran or stood in the queue for a core (Linux)."""
    ran, queued, _ = Path(f"/proc/{process_id}/schedstat").read_text(encoding="ascii").split()
    return (int(ran) + int(queued)) / 1e9


def bare(configuration: SweepConfiguration, fabrics: FabricTable) -> Run:
    """Solve and render in a plain loop."""
    solver = Solver(configuration.mesh)
    layout = configuration.layout
    begun = time.monotonic()
    wall = cpu = 0.0
    for number in range(-1, layout.simulations):  # the first one compiles and is not counted
        if number == 0:
            start_s, wall, cpu = time.monotonic() - begun, time.monotonic(), time.process_time()
        material, scene, jitter = layout.address(max(number, 0))
        seed = simulation_seed(configuration.seed, (material, scene, jitter))
        parameters = fabrics.parameters([material])[0]
        simulate_and_render(parameters, configuration.scenes[scene], seed, configuration, solver)
    count = layout.simulations
    cpu_s = (time.process_time() - cpu) / count
    return Run((time.monotonic() - wall) / count, cpu_s, start_s, cpu_s)


def costs(resolutions: list[float], materials: int) -> Iterator[dict[str, float]]:
    """Measured CPU seconds of a simulation with its pictures beside the estimate before a sweep."""
    for resolution in resolutions:
        configuration, fabrics = plan_sweep(materials=materials, jitters=1, resolution_m=resolution)
        count = configuration.layout.simulations
        yield {
            "resolution_m": resolution,
            "simulations": count,
            "cpu_s": bare(configuration, fabrics).cpu_s,
            "estimated_s": estimate_cost(configuration, 1).core_hours * 3600 / count,
        }


class TimedWorker(ShardWorker):
    """Notes the CPU seconds that it spends in solving and rendering, in a file beside the store."""

    def __init__(self, url: str, configuration: SweepConfiguration) -> None:
        super().__init__(url, configuration)
        from services.dataset import shard

        note, plain, spent = Path(url).with_name(f"{os.getpid()}.cpu"), shard.simulate_and_render, 0.0

        def timed(*arguments: Any) -> Outcome:
            nonlocal spent
            begun = time.process_time()
            outcome = plain(*arguments)
            spent += time.process_time() - begun
            note.write_text(str(spent))
            return outcome

        shard.simulate_and_render = timed


def service(configuration: SweepConfiguration, fabrics: FabricTable, workers: int, place: Path) -> Run:
    """The same through the service; the first word of every worker is its warm-up."""
    place.mkdir()
    url, began = str(place / "store.zarr"), time.monotonic()
    shards = prepare_store(url, configuration, resume=False)
    seen: set[int] = set()
    first = last = (0.0, 0.0, 0.0, 0.0)
    words = counted_from = 0

    def listen(word: SimulationDone) -> None:
        nonlocal words, counted_from, first, last
        words += 1
        seen.add(word.process_id)
        if len(seen) == workers:
            work = sum(float(note.read_text()) for note in place.glob("*.cpu"))
            last = (time.monotonic(), family_cpu_s(), work, sum(map(wanted_core_s, seen)))
            if not counted_from:
                first, counted_from = last, words

    with ray_cluster("local", workers):
        Dispatcher(url, configuration, fabrics, DispatchOptions(workers), listen, TimedWorker).run(shards)
    wall, cpu, work, wanted = ((end - start) / (words - counted_from) for start, end in zip(first, last, strict=True))
    return Run(wall, cpu, first[0] - began, work, wanted / wall / workers)


def memory(tasks: int, url: str) -> list[tuple[int, int, int]]:
    """(task, worker's process, resident bytes) over many small tasks on two workers that are never replaced."""
    configuration, fabrics = plan_sweep(
        materials=tasks, jitters=1, scenes=("hanging",), inclinations=2, resolution_m=0.05, simulations_per_shard=1
    )
    points: list[tuple[int, int, int]] = []

    def listen(word: SimulationDone) -> None:
        points.append((len(points), word.process_id, word.rss_bytes))

    run_sweep(url, configuration, fabrics, workers=2, recycle_after=tasks + 1, listen=listen)
    return points


class TalkingWorker:
    """Simulates nothing and says so as fast as it can: what the driver itself can follow."""

    def __init__(self, url: str, configuration: SweepConfiguration) -> None:
        self.layout = configuration.layout

    def run(self, task: ShardTask) -> Iterator[SimulationDone]:
        """One word a simulation."""
        numbers = self.layout.shard_simulations(task.shard)
        for number in numbers:
            yield SimulationDone(number, RowStatus.OK, number, "here", os.getpid(), 0, number == numbers[-1])


def driver_words_per_cpu_s() -> float:
    """Simulations a second of its own CPU time that the driver's loop can follow."""
    configuration, fabrics = plan_sweep(materials=1600, jitters=1, simulations_per_shard=32)
    with ray_cluster("local", 2) as workers:
        dispatcher = Dispatcher("", configuration, fabrics, DispatchOptions(workers, 10**9), worker_class=TalkingWorker)
        start = time.process_time()
        dispatcher.run(range(configuration.layout.shards))
        return configuration.layout.simulations / (time.process_time() - start)


def draw_memory(points: list[tuple[int, int, int]], path: Path) -> None:
    """Resident memory against tasks."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 3), layout="constrained")
    axes = figure.add_subplot(xlabel="tasks (whole shards)", ylabel="resident memory of a worker [MB]")
    for worker in sorted({process for _, process, _ in points}):
        mine = [(task, rss / 1e6) for task, process, rss in points if process == worker]
        axes.plot(*zip(*mine, strict=True), label=f"worker {worker}")
    axes.set_ylim(0, 1.25e-6 * max(rss for _, _, rss in points))
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=90)


def growth_mb(points: list[tuple[int, int, int]]) -> float:
    """Largest growth of a worker between the first tenth of its tasks and the last [MB]."""
    growths = []
    for worker in {process for _, process, _ in points}:
        rss = np.array([r for _, process, r in points if process == worker]) / 1e6
        tenth = max(1, len(rss) // 10)
        growths.append(float(np.median(rss[-tenth:]) - np.median(rss[tenth : 2 * tenth])))
    return max(growths)


def reading(url: str) -> dict[str, float]:
    """Pictures a second of CPU time: shards decoded, and pairs out of the training loader (no cache, no resizing)."""
    from trainer.dataset import PairStream
    from trainer.store_source import StoreSource

    store = Store.open(url)
    store.depth_counts(0)
    start, pictures = time.process_time(), 0
    for shard in range(store.shards):
        pictures += len(store.depth_counts(shard))
    decoded = pictures / (time.process_time() - start)
    source = StoreSource(url)
    table = source.table()
    start, pictures = time.process_time(), 0
    for _, present, _, _ in PairStream(source, table, size=256, passes=1, cache_bytes=0):
        pictures += int(present.sum())
    return {"decoded_per_s": decoded, "loader_per_s": pictures / (time.process_time() - start)}


def report(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Run everything."""
    configuration, fabrics = plan_sweep(
        materials=options.materials, jitters=1, resolution_m=options.resolution, simulations_per_shard=options.shard
    )
    plain = bare(configuration, fabrics)
    one = service(configuration, fabrics, 1, folder / "one")
    two = service(configuration, fabrics, 2, folder / "two")
    first, second = (Store.open(folder / name / "store.zarr") for name in ("one", "two"))
    same = first.checksums.tobytes() == second.checksums.tobytes()
    store = inspect_store(second)
    points = memory(options.tasks, str(folder / "many.zarr")) if options.tasks else []
    if options.figure:
        draw_memory(points, options.figure)
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}",
        "simulations": configuration.layout.simulations,
        "resolution_m": options.resolution,
        "bare_cpu_s": plain.cpu_s,
        "bare_wall_s": plain.wall_s,
        "service_cpu_s": one.cpu_s,
        "service_wall_s": one.wall_s,
        "solve_and_render_cpu_s": one.work_s,
        "overhead_cpu": one.cpu_s / one.work_s - 1.0,
        "overhead_wall": one.wall_s / plain.wall_s - 1.0,
        "two_workers_wall_s": two.wall_s,
        "two_workers_cpu_s": two.cpu_s,
        "two_workers_overhead_cpu": two.cpu_s / two.work_s - 1.0,
        "busy_share": one.busy,
        "two_workers_busy_share": two.busy,
        "speed_up_wall": one.wall_s / two.wall_s,
        "start_s": one.start_s,
        "same_bits": same,
        "failed": store.failed,
        "bytes_per_picture": store.bytes_per_picture,
        "times_smaller_than_float32": store.float32_ratio,
        "bytes_per_simulation": store.stored_bytes / configuration.layout.simulations,
        **reading(second.url),
        "driver_simulations_per_cpu_s": driver_words_per_cpu_s(),
        "tasks": options.tasks,
        **({"rss_growth_mb": growth_mb(points), "rss_mb": points[-1][2] / 1e6} if points else {}),
    }


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--materials", type=int, default=12)
    parser.add_argument("--resolution", type=float, default=0.01)
    parser.add_argument("--tasks", type=int, default=1000, help="of the memory test; 0 leaves it out")
    parser.add_argument("--shard", type=int, default=4, help="simulations of a shard")
    parser.add_argument("--costs", help="mesh cells [m], separated by commas: check the cost estimate, nothing else")
    add_json_option(parser, "dataset")
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    if options.costs:
        for row in costs([float(r) for r in options.costs.split(",")], options.materials):
            print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), flush=True)
        return
    with tempfile.TemporaryDirectory() as folder:
        numbers = report(options, Path(folder))
    for name, value in numbers.items():
        print(f"{name:28s} {value:.4g}" if isinstance(value, float) else f"{name:28s} {value}")
    options.json.write_text(json.dumps(numbers, indent=1))


if __name__ == "__main__":
    main()
