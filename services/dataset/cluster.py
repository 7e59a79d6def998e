"""Ray: a quiet local cluster, or a running one by its address."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from simcore.errors import InputError

_STORE_BYTES = 100 * 2**20
"""Ray's object store: only keys and small words travel through it, data goes to the Zarr store."""


@contextmanager
def ray_cluster(address: str | None, workers: int | None) -> Iterator[int]:
    """Ray for the length of the block; the number of workers to use is given.

    Args:
        address: ``auto``, ``host:port`` or ``ray://...`` of a running cluster (its store must be reachable from every
            node); None takes ``RAY_ADDRESS``, else starts a cluster on this machine that ends with the block.
        workers: None takes every CPU of the cluster, or of this machine.

    Raises:
        InputError: no cluster at the address.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    import ray

    address = address or os.environ.get("RAY_ADDRESS") or None
    count = workers or len(os.sched_getaffinity(0))
    quiet: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False}
    if address in (None, "local"):
        ray.init(
            address="local",
            num_cpus=count,
            num_gpus=0,
            include_dashboard=False,
            object_store_memory=_STORE_BYTES,
            _node_ip_address="127.0.0.1",
            **quiet,
        )
    else:
        try:
            ray.init(address=address, **quiet)
        except ray.exceptions.AuthenticationError:
            raise InputError(
                f"the Ray cluster at {address} wants its token: set RAY_AUTH_MODE=token and RAY_AUTH_TOKEN",
                code="cluster_token",
            ) from None
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise InputError(
                f"no Ray cluster answers at {address} ({str(error).splitlines()[0]}); "
                "start one, or leave --address out",
                code="cluster_missing",
            ) from None
        count = workers or max(1, int(cluster_cpus()))
    try:
        yield count
    finally:
        ray.shutdown()


def cluster_cpus() -> float:
    """CPUs that the connected cluster declares."""
    import ray

    resources: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]  # ray does not annotate it
    return resources.get("CPU", 1.0)
