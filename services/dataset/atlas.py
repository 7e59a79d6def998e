"""An atlas's simulations as Ray tasks: each solves a part into a folder of its own and sends back what it kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from diagnosis.atlas import PartSolver
from diagnosis.atlas_part import AtlasPart
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Cost
from services.dataset.cluster import ray_cluster
from services.dataset.spread import spread


def solver_on_ray(address: str | None, workers: int | None) -> PartSolver:
    """Solves parts on a running cluster (``auto``, ``host:port``, ``ray://...``), or on its own one of so many workers.

    The nodes share no folder: what a part kept comes back through Ray and is kept here.

    Raises:
        InputError: when it is used: no cluster at the address.
        SimulationError: when it is used: workers die of a part again and again.
    """

    def solve(parts: Sequence[AtlasPart], cache: DrapeCache) -> Iterator[Cost]:
        if not parts:
            return
        with ray_cluster(address, workers) as cores:
            yield from _keep(parts, cache, cores)

    return solve


def _keep(parts: Sequence[AtlasPart], cache: DrapeCache, cores: int) -> Iterator[Cost]:
    for files, cost in spread(_solve_apart, parts, cores):
        cache.take(files)
        yield cost


def _solve_apart(part: AtlasPart) -> tuple[dict[str, bytes], Cost]:
    with TemporaryDirectory() as folder:
        cache = DrapeCache(Path(folder))
        cost = part.solve(cache)
        return cache.files(), cost
