"""Work on many items as Ray tasks, a bounded window at a time."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from services.dataset.cluster import LOGS, has_workers
from simcore.errors import SimulationError, StoreError

Given = TypeVar("Given")
Made = TypeVar("Made")

WINDOW_PER_CORE = 2
"""Tasks under way for each core of the cluster: enough to keep it busy, few enough to hold in memory."""
DEATHS = ("WorkerCrashedError", "OutOfMemoryError", "NodeDiedError")
"""Of Ray: a task's worker died, and so did those that began it again."""
PATIENCE_S, START_ALLOWANCE_S = 60.0, 900.0
"""So often it is looked whether the cluster has workers while nothing is done, and so long it may have none, or none
that start."""
RETRIES = 3
"""So often a task is begun again whose worker or node died."""


def spread(work: Callable[[Given], Made], items: Sequence[Given], cores: int) -> Iterator[Made]:
    """What ``work`` makes of every item, as they are done; Ray must be running (``cluster.ray_cluster``).

    Args:
        work: a function of a module that the workers have, too.
        items: one for each task of one core.
        cores: of the cluster.

    Raises:
        Exception: whatever ``work`` raised; tasks under way are called off.
        SimulationError: workers die again and again.
        StoreError: the cluster has no worker, or starts none (``workers_missing``).
    """
    import ray

    # Sealed, because a cluster's server of clients (``ray://``) opens what passes through it: it would import what the
    # workers need, and dies of Taichi beside Ray's own libraries.
    remote: Any = ray.remote(_sealed).options(name=work.__name__, num_cpus=1, max_retries=RETRIES)
    waiting = list(reversed(items))
    pending: list[Any] = []
    silence = _Silence()
    try:
        while waiting or pending:
            while waiting and len(pending) < cores * WINDOW_PER_CORE:
                pending.append(remote.remote(pickle.dumps((work, waiting.pop()))))
            done, pending = ray.wait(pending, num_returns=1, timeout=PATIENCE_S)
            if done:
                silence.ended()
            else:
                silence.check()
            yield from (pickle.loads(parcel) for parcel in ray.get(done))
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None  # with its code and without the worker's traceback
    except tuple(getattr(ray.exceptions, name) for name in DEATHS) as error:
        raise SimulationError(
            f"work on the cluster cannot be done, its worker dies each time ({type(error).__name__}): the machine may "
            "be out of memory; try fewer workers or a coarser mesh. What is done and kept in a cache stays",
            code="worker_died",
        ) from None
    finally:
        for task in [*pending, *silence.asked]:
            ray.cancel(task)


class _Silence:
    """Nothing is done: work may take long, but a cluster may also have no worker, or start none.

    Attributes:
        asked: a task that is done at once, on CPUs that are all at work, too, wherever a worker can be started.
    """

    def __init__(self) -> None:
        self.asked: list[Any] = []
        self._heard = self._without = time.monotonic()

    def ended(self) -> None:
        """Some work is done."""
        self._heard = time.monotonic()

    def check(self) -> None:
        """Work is not done yet.

        Raises:
            StoreError: nor will it be: there has been no worker, or none that starts, for as long as is allowed.
        """
        import ray

        now = time.monotonic()
        if not has_workers():
            self._without = now
            if now - self._heard > START_ALLOWANCE_S:
                raise StoreError(
                    f"the cluster has had no worker for {START_ALLOWANCE_S:.0f} s: start some, then the same again",
                    code="workers_missing",
                )
            return
        if not self.asked:
            self.asked = [ray.remote(_nothing).options(num_cpus=0).remote()]
            self._without = now
        if now - self._without > START_ALLOWANCE_S and not ray.wait(self.asked, timeout=0)[0]:
            raise StoreError(
                f"the cluster has had CPUs for {START_ALLOWANCE_S:.0f} s and could start no process on them: "
                f"{LOGS} on its machines say why",
                code="workers_missing",
            )


def _nothing() -> None:
    """Done as soon as a worker is there."""


def _sealed(parcel: bytes) -> bytes:
    """Do a piece of work that came sealed, in a worker; seal what it makes."""
    work, item = pickle.loads(parcel)
    return pickle.dumps(work(item))
