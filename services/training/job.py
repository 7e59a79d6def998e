"""Training as a Ray job: one actor a rank, each with its own shards, gradients averaged over gloo."""

from __future__ import annotations

import socket
from collections.abc import Callable, Sequence
from datetime import timedelta
from typing import TYPE_CHECKING, Any

from renderer.store_location import is_remote, local_path
from services.dataset.cluster import cluster_cpus, ray_cluster
from simcore.errors import DrapemeterError, InputError, StoreError

if TYPE_CHECKING:
    from trainer.config import TrainConfig
    from trainer.model import TrainedModel
    from trainer.train import Progress

POLL_S = 0.5
START_ALLOWANCE_S = 900.0
"""So long it is waited until every rank has its CPUs, as a sweep waits for its workers: a cluster may have to grow."""
MEETING = timedelta(minutes=30)
"""So long ranks try to meet, and wait for each other's messages from then on (gloo's own)."""
DEATH_S = 10.0
"""So long it is waited for what the other ranks say: where one dies, the others fail of it, and may be heard first."""


class TrainingRank:
    """One of the processes that train together; a Ray actor with a second thread for questions.

    Args:
        stores: URLs that every node reaches.
        config: the run.
        start: an earlier model to go on from.
        rank, world_size: which of how many.
    """

    def __init__(
        self, stores: Sequence[str], config: TrainConfig, start: TrainedModel | None, rank: int, world_size: int
    ) -> None:
        self._stores, self._config, self._start = stores, config, start
        self._rank, self._world_size = rank, world_size
        self._progress: Progress | None = None

    def meeting_place(self) -> str:
        """On rank 0: the address where the ranks meet."""
        import ray

        util: Any = ray.util  # ray does not annotate it
        host = util.get_node_ip_address()
        with socket.socket() as free:
            free.bind((host, 0))
            return f"tcp://{host}:{free.getsockname()[1]}"

    def run(self, meeting_place: str) -> TrainedModel | None:
        """Train this rank's share; rank 0 calibrates and returns the model.

        Raises:
            InputError: the store cannot be used, or has too few shards.
        """
        import torch.distributed as dist

        from trainer.dataset import Partition
        from trainer.several_stores import open_stores
        from trainer.train import finish, learn

        partition = Partition(self._rank, self._world_size)
        if self._world_size > 1:
            self._meet(meeting_place)
        source = open_stores(self._stores, self._config.inclinations)
        learnt = learn(
            source,
            self._config,
            partition=partition,
            start=self._start,
            provenance=source.provenance(),
            report=self._remember,
        )
        if self._world_size > 1:
            dist.destroy_process_group()
        return finish(learnt) if self._rank == 0 else None

    def _meet(self, meeting_place: str) -> None:
        import torch.distributed as dist

        try:
            dist.init_process_group(
                "gloo", init_method=meeting_place, rank=self._rank, world_size=self._world_size, timeout=MEETING
            )
        except RuntimeError as error:  # of whatever layer: each has its own kind
            why = (str(error).splitlines() or [type(error).__name__])[0]
            raise DrapemeterError(
                f"rank {self._rank} of the training has not met the others at {meeting_place} ({why}): ranks talk to "
                "each other over any free ports, which must be open between the nodes; or use fewer --ranks",
                code="ranks_apart",
            ) from None

    def progress(self) -> Progress | None:
        """Where the run stands."""
        return self._progress

    def _remember(self, progress: Progress) -> None:
        self._progress = progress


def train_on_ray(
    stores: Sequence[str],
    config: TrainConfig,
    *,
    ranks: int = 1,
    address: str | None = None,
    start: TrainedModel | None = None,
    report: Callable[[Progress], None] | None = None,
) -> TrainedModel:
    """Train as a Ray job.

    Each rank asks for ``config.threads`` CPUs and works on its own shards; a batch of ``config.batch_size`` pictures a
    rank. When one rank fails, all are stopped.

    Args:
        stores: URLs that every node reaches.
        config: the run.
        ranks: processes that train together.
        address: of a running cluster; None takes ``RAY_ADDRESS``, else starts one here.
        start: an earlier model to go on from.
        report: called with rank 0's progress now and then.

    Raises:
        InputError: the store or the cluster cannot be used.
        DrapemeterError: a rank's process died.
        StoreError: the cluster has not had CPUs for all ranks within :data:`START_ALLOWANCE_S`.
    """
    if ranks < 1:
        raise InputError(f"{ranks} ranks: give at least 1", code="ranks")
    _check_stores(stores, config, start, ranks)
    # Ray's workers are in another folder
    stores = tuple(url if is_remote(url) else str(local_path(url).absolute()) for url in stores)
    with ray_cluster(address, ranks * config.threads):
        return _train(stores, config, start, ranks, report)


def _check_stores(stores: Sequence[str], config: TrainConfig, start: TrainedModel | None, ranks: int) -> None:
    """Find out what would stop every rank before a cluster is started."""
    from trainer.dataset import check_lanes
    from trainer.several_stores import open_stores
    from trainer.train import split_of, training_pictures

    table = open_stores(stores).table()
    check_lanes(training_pictures(table, split_of(table, config, start), config), ranks * max(1, config.workers))


def _train(
    stores: Sequence[str],
    config: TrainConfig,
    start: TrainedModel | None,
    ranks: int,
    report: Callable[[Progress], None] | None,
) -> TrainedModel:
    import ray
    from ray.exceptions import RayActorError, RayTaskError

    actor_class: Any = ray.remote(TrainingRank).options(num_cpus=config.threads, max_concurrency=2)
    actors = [actor_class.remote(stores, config, start, rank, ranks) for rank in range(ranks)]
    runs = [actors[0].meeting_place.remote(), *(actor.progress.remote() for actor in actors[1:])]
    try:
        _, absent = ray.wait(runs, num_returns=ranks, timeout=START_ALLOWANCE_S)
        if absent:
            raise _too_few_cpus(len(absent), ranks, config.threads)
        place = ray.get(runs)[0]
        runs = [actor.run.remote(place) for actor in actors]
        waiting = list(runs)
        while waiting:
            ready, waiting = ray.wait(waiting, timeout=POLL_S)
            ray.get(ready)  # a failed rank speaks up before the others wait for it in vain
            progress = ray.get(actors[0].progress.remote())
            if report is not None and progress is not None:
                report(progress)
        model: TrainedModel = ray.get(runs[0])
    except (RayTaskError, RayActorError) as error:
        if isinstance(error, RayTaskError) and isinstance(error.cause, DrapemeterError):
            raise error.cause from None
        reason = _reason(runs)
        if reason is None:
            raise
        raise reason from None
    finally:
        for actor in actors:
            ray.kill(actor)
    return model


def _too_few_cpus(absent: int, ranks: int, threads: int) -> StoreError:
    """Of a cluster that has no room for all: those that are there would wait for the others without an end."""
    return StoreError(
        f"{absent} of {ranks} ranks have not come up in {START_ALLOWANCE_S:.0f} s: they need {threads} free CPUs each, "
        f"and the cluster has {cluster_cpus():.0f} in all; try fewer --ranks or --threads",
        code="workers_missing",
    )


def _reason(runs: list[Any]) -> DrapemeterError | None:
    """What ended the ranks, of those that have ended: one whose process is gone, or one that says what is wrong."""
    import ray
    from ray.exceptions import RayActorError, RayTaskError

    ended, _ = ray.wait(runs, num_returns=len(runs), timeout=DEATH_S)
    for run in ended:
        try:
            ray.get(run)
        except RayActorError:
            return DrapemeterError(
                f"rank {runs.index(run)} of the training died, and nothing was kept: its machine may be out of memory "
                "or gone; try fewer --ranks or a smaller --input-size",
                code="worker_died",
            )
        except RayTaskError as error:
            if isinstance(error.cause, DrapemeterError):
                return error.cause
    return None
