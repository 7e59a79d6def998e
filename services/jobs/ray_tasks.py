"""Simulations as Ray tasks: long-lived workers, a bounded window, nothing heavier than pictures comes back."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from simcore.errors import MissingResourceError

if TYPE_CHECKING:
    from metric.draping import DrapeRequest, RequestResult

WINDOW_PER_CORE = 2
"""Tasks under way for each core of the cluster: enough to keep it busy, few enough to hold in memory."""


def connect(address: str) -> None:
    """Join a cluster; again does no harm.

    Raises:
        MissingResourceError: it does not answer.
    """
    import ray

    if ray.is_initialized():
        return
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.WARNING)
    except ConnectionError as error:
        raise MissingResourceError(
            f"the Ray cluster {address} cannot be reached ({error}): check that it runs", code="ray_unreachable"
        ) from None


def ray_runner(address: str) -> Callable[[Sequence[DrapeRequest]], Iterator[RequestResult]]:
    """A runner for :func:`metric.simulate.simulate_fabrics` that spreads simulations over a cluster."""

    def run(requests: Sequence[DrapeRequest]) -> Iterator[RequestResult]:
        import ray

        from metric.draping import run_request

        connect(address)
        remote = ray.remote(run_request).options(num_cpus=1, max_retries=3)
        cores: float = ray.cluster_resources().get("CPU", 1.0)  # type: ignore[no-untyped-call]  # Ray has no types here
        window = max(1, int(cores)) * WINDOW_PER_CORE
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

    return run
