"""Simulations as Ray tasks: long-lived workers, a bounded window, nothing heavier than pictures comes back."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metric.draping import DrapeRequest, RequestResult


def ray_runner(address: str) -> Callable[[Sequence[DrapeRequest]], Iterator[RequestResult]]:
    """A runner for :func:`metric.simulate.simulate_fabrics` that spreads simulations over a cluster.

    Raises:
        InputError: there is no cluster at the address, or it wants a token.
    """

    def run(requests: Sequence[DrapeRequest]) -> Iterator[RequestResult]:

        from metric.draping import run_request
        from services.dataset.cluster import ray_cluster
        from services.dataset.spread import spread

        if not requests:
            return
        with ray_cluster(address, None) as cores:
            yield from spread(run_request, requests, cores)

    return run
