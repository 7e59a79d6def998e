"""An atlas's simulations as Ray tasks: each solves a part into a folder of its own and sends back what it kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from diagnosis.atlas import PartSolver
from diagnosis.atlas_part import AtlasPart
from diagnosis.drape_cache import DrapeCache
from diagnosis.simulator import Cost
from services.dataset.cluster import ray_cluster
from simcore.errors import SimulationError

WINDOW_PER_CORE = 2
"""Parts under way for each worker: enough to keep it busy, few enough to hold in memory."""
RETRIES = 3
"""So often a part is begun again whose worker or node died."""


def solver_on_ray(address: str | None, workers: int | None) -> PartSolver:
    """Solves parts on a running cluster (``auto``, ``host:port``), or on one of its own with so many workers.

    The nodes share no folder: what a part kept comes back through Ray and is kept here.

    Raises:
        InputError: when it is used: no cluster at the address.
        SimulationError: when it is used: workers die of a part again and again.
    """

    def solve(parts: Sequence[AtlasPart], cache: DrapeCache) -> Iterator[Cost]:
        if not parts:
            return
        with ray_cluster(address, workers) as count:
            yield from _spread(parts, cache, count * WINDOW_PER_CORE)

    return solve


def _spread(parts: Sequence[AtlasPart], cache: DrapeCache, window: int) -> Iterator[Cost]:
    import ray

    remote = ray.remote(_solve_apart).options(num_cpus=1, max_retries=RETRIES)
    waiting = list(reversed(parts))
    pending: list[Any] = []
    try:
        while waiting or pending:
            while waiting and len(pending) < window:
                pending.append(remote.remote(waiting.pop()))
            done, pending = ray.wait(pending, num_returns=1)
            files, cost = ray.get(done[0])
            cache.take(files)
            yield cost
    except (ray.exceptions.WorkerCrashedError, ray.exceptions.OutOfMemoryError, ray.exceptions.NodeDiedError) as error:
        raise SimulationError(
            f"a part of the atlas cannot be solved, its worker dies each time ({type(error).__name__}): the machine "
            "may be out of memory; try fewer workers or a coarser mesh. What is solved is kept",
            code="worker_died",
        ) from None
    finally:
        for task in pending:
            ray.cancel(task)


def _solve_apart(part: AtlasPart) -> tuple[dict[str, bytes], Cost]:
    with TemporaryDirectory() as folder:
        cache = DrapeCache(Path(folder))
        cost = part.solve(cache)
        return cache.files(), cost
