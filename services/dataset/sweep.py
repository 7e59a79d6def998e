"""A sweep from start or resumption to a complete store."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from renderer.store import RowStatus, Store, StoreWriter, store_exists
from renderer.store_location import is_remote, local_path
from services.dataset.cluster import is_local, is_ray_client, ray_cluster
from services.dataset.configuration import SweepConfiguration
from services.dataset.cost import CostEstimate, estimate_cost
from services.dataset.dispatch import DispatchOptions
from services.dataset.drive import Drive
from services.dataset.fabrics import FabricTable
from services.dataset.own_store import check_settings
from services.dataset.solver_kind import SolverKind
from services.dataset.tally import Tally
from services.dataset.worker import SimulationDone
from services.version import data_version
from simcore.errors import InputError, StoreError

LEFT_OVER_S = 3600.0
"""What is begun and was not written to for so long nobody writes any more."""


@dataclass(frozen=True)
class SweepSummary:
    """What a sweep ended with.

    Attributes:
        samples: rows of the store.
        failed: number of failed rows by status.
        seconds: wall-clock time of this run.
    """

    samples: int
    failed: dict[str, int]
    seconds: float


def prepare_store(url: str, configuration: SweepConfiguration, *, resume: bool) -> list[int]:
    """Lay the store out, or check that the one there is of the same sweep; returns the shards still to do.

    Raises:
        InputError: a store is there and ``resume`` is not given, or it is of another configuration or version, or the
            place cannot be written to.
        StoreError: the place fails.
    """
    left = shards_left(url, configuration, resume=resume)
    if left is not None:
        return left
    StoreWriter.create(
        url,
        configuration.layout,
        configuration=configuration.model_dump(mode="json"),
        seed=configuration.seed,
        software_version=_version(configuration),
    )
    return _shards_left(url, configuration)  # another sweep may have been laid out at the same moment


def shards_left(url: str, configuration: SweepConfiguration, *, resume: bool) -> list[int] | None:
    """Shards that a store still lacks; None where none is laid out yet. Nothing is written.

    Raises:
        InputError: as :func:`prepare_store`.
        StoreError: the place fails.
    """
    if not store_exists(url):
        return None
    if not resume:
        raise InputError(
            f"{url}: a store is there already; finish it with --resume or choose another --out", code="store_exists"
        )
    return _shards_left(url, configuration)


def _shards_left(url: str, configuration: SweepConfiguration) -> list[int]:
    store = Store.open(url)
    check_settings(store, configuration)
    if store.stated["software_version"] != _version(configuration):
        raise InputError(
            f"{url}: was begun with version {store.attributes['software_version']}, this is {_version(configuration)}; "
            "finish it with the same version, or choose another --out",
            code="store_version",
        )
    return [int(shard) for shard in np.flatnonzero(~store.complete)]


def _version(configuration: SweepConfiguration) -> str:
    """Version of what makes a sweep's rows."""
    return data_version(batch=configuration.solver is not SolverKind.SINGLE, drawn=configuration.design.draws)


def run_sweep(
    url: str | Path,
    configuration: SweepConfiguration,
    fabrics: FabricTable,
    *,
    resume: bool = False,
    address: str | None = None,
    workers: int | None = None,
    recycle_after: int = 2000,
    listen: Callable[[SimulationDone], None] = lambda word: None,
    begin: Callable[[CostEstimate], None] = lambda cost: None,
) -> SweepSummary:
    """Simulate and render a whole sweep into a store.

    Args:
        url: where the store is or shall be: local folder or URL.
        configuration, fabrics: the sweep, from :func:`~services.dataset.fabrics.plan_sweep`.
        resume: finish a store that is there.
        address, workers: see :func:`~services.dataset.cluster.ray_cluster`.
        recycle_after: simulations after which a worker's process is replaced.
        listen: called after each simulation, once even where its shard is done again.
        begin: called once before the work, with what it will cost; not when nothing is left to do.

    Raises:
        InputError: bad input; nothing was damaged.
        StoreError: the store's place failed, or another process took finished shards away; ``resume`` does the rest.
    """
    started = time.monotonic()
    tally = Tally()

    def hear(word: SimulationDone) -> None:
        if tally.is_new(word.simulation):
            listen(word)

    place = str(url) if is_remote(url) else str(local_path(url).absolute())
    if shards_left(place, configuration, resume=resume) != []:
        on_gpu = configuration.solver is SolverKind.CUDA
        # a bad place is told before Ray is started; a bad address, or that there is no GPU, before anything is written
        if is_local(address) and not on_gpu:
            prepare_store(place, configuration, resume=resume)
            resume = True
        with ray_cluster(address, workers, gpus=on_gpu) as count:
            shards = prepare_store(place, configuration, resume=resume)
            remaining = sum(len(configuration.layout.shard_simulations(shard)) for shard in shards)
            begin(estimate_cost(configuration, count, remaining))
            options = DispatchOptions(
                workers=min(count, len(shards)), recycle_after=recycle_after, gpus_per_worker=1.0 if on_gpu else 0.0
            )
            drive = Drive(place, configuration, fabrics, options, shards)
            if is_ray_client():
                drive.run_on_cluster(hear)
            else:
                drive.run(hear)
    store = Store.open(place)
    if not store.complete.all():
        raise StoreError(
            f"{int((~store.complete).sum())} shards of {url} are not there, though each was stored: does another sweep "
            "write to it?",
            code="shards_missing",
        )
    if not is_remote(place):
        _remove_leftovers(local_path(place))
    return SweepSummary(len(store), count_failures(store), time.monotonic() - started)


def _remove_leftovers(folder: Path) -> None:
    """What writers killed in the middle of an object left, and not what another driver writes just now."""
    for leftover in folder.rglob("*.partial"):
        with suppress(OSError):
            if time.time() - leftover.stat().st_mtime > LEFT_OVER_S:
                leftover.unlink()


def count_failures(store: Store) -> dict[str, int]:
    """Failed or missing rows by status; all rows of a shard that is not finished are missing."""
    status = np.where(store.finished, store.status, RowStatus.MISSING)
    codes, counts = np.unique(status[status != RowStatus.OK], return_counts=True)
    return {RowStatus(int(code)).label: int(count) for code, count in zip(codes, counts, strict=True)}
