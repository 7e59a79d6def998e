"""Simulations as Ray tasks: long-lived workers, a bounded window, nothing heavier than pictures comes back."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from metric.draping import DrapeRequest, RequestResult

WINDOW_PER_CORE = 2
"""Tasks under way for each core of the cluster: enough to keep it busy, few enough to hold in memory."""


def ray_runner(address: str) -> Callable[[Sequence[DrapeRequest]], Iterator[RequestResult]]:
    """A runner for :func:`metric.simulate.simulate_fabrics` that spreads simulations over a cluster.

    Raises:
        InputError: there is no cluster at the address, or it wants a token.
    """

    def run(requests: Sequence[DrapeRequest]) -> Iterator[RequestResult]:
        from services.dataset.cluster import ray_cluster

        if not requests:
            return
        with ray_cluster(address, None) as cores:
            yield from _spread(requests, cores * WINDOW_PER_CORE)

    return run


def _spread(requests: Sequence[DrapeRequest], window: int) -> Iterator[RequestResult]:
    import ray

    from metric.draping import run_request

    remote = ray.remote(run_request).options(num_cpus=1, max_retries=3)
    waiting = list(reversed(requests))
    pending: list[Any] = []
    try:
        while waiting or pending:
            while waiting and len(pending) < window:
                pending.append(remote.remote(waiting.pop()))
            done, pending = ray.wait(pending, num_returns=1)
            yield from ray.get(done)
    finally:
        for task in pending:
            ray.cancel(task)
