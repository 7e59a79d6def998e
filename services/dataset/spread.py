"""Work on many items as Ray tasks, a bounded window at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

Given = TypeVar("Given")
Made = TypeVar("Made")

WINDOW_PER_CORE = 2
"""Tasks under way for each core of the cluster: enough to keep it busy, few enough to hold in memory."""
RETRIES = 3
"""So often a task is begun again whose worker or node died."""


def spread(work: Callable[[Given], Made], items: Sequence[Given], cores: int) -> Iterator[Made]:
    """What ``work`` makes of every item, as they are done; Ray must be running (``cluster.ray_cluster``).

    Args:
        work: a function of a module that the workers have, too.
        items: one for each task of one core.
        cores: of the cluster.

    Raises:
        Exception: whatever ``work`` raised, or Ray where workers die again and again; tasks under way are called off.
    """
    import ray

    remote: Any = ray.remote(work).options(num_cpus=1, max_retries=RETRIES)
    waiting = list(reversed(items))
    pending: list[Any] = []
    try:
        while waiting or pending:
            while waiting and len(pending) < cores * WINDOW_PER_CORE:
                pending.append(remote.remote(waiting.pop()))
            done, pending = ray.wait(pending, num_returns=1)
            yield from ray.get(done)
    finally:
        for task in pending:
            ray.cancel(task)
