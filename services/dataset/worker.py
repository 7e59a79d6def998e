"""The long-lived worker: one process, one Taichi runtime, one solver, many shards."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from renderer.atomic import NO_ROOM
from renderer.store import RowStatus, ShardRows, Store, StoreWriter
from services.dataset.configuration import SweepConfiguration
from services.dataset.own_store import check_settings, check_shards
from services.dataset.shard import ShardTask, shard_requests, simulate_shard
from services.dataset.solver_kind import SolverKind
from services.dataset.solving import ShardSolver
from simcore.errors import MissingResourceError, OutOfMemoryError

if TYPE_CHECKING:
    from simcore.solver import Solver

WORKER_MACHINE = "worker_machine"
"""Code of a machine that cannot simulate."""
DISK_FULL = "no_room"
"""Code of one whose disk is full, for which a job waits."""


@dataclass(frozen=True)
class SimulationDone:
    """A worker's word after each simulation; after the last one of a shard, the shard is stored.

    Attributes:
        simulation: its number in the sweep.
        status: how it ended.
        solves: simulations this worker has done since it started.
        host: the worker's machine, pod or container.
        process_id: the worker's process there.
        rss_bytes: memory the worker holds.
        stored: the shard is written and marked complete.
        found: it was stored already, by another driver or another run of this one; nothing was done.
    """

    simulation: int
    status: RowStatus
    solves: int
    host: str
    process_id: int
    rss_bytes: int
    stored: bool
    found: bool = False


@dataclass(frozen=True)
class ShardSolved:
    """A worker's word when all of a shard's simulations are done and it goes on to write them.

    Attributes:
        shard: its number.
    """

    shard: int


class ShardWorker:
    """Simulates, renders and writes whole shards. Run as a Ray actor, usable without Ray.

    Args:
        url: the store, already laid out.
        configuration: the sweep.
    """

    def __init__(self, url: str, configuration: SweepConfiguration) -> None:
        self._url = url
        self._configuration = configuration
        self._solver: Solver | ShardSolver | None = None
        self._writer: StoreWriter | None = None
        self._solves = 0

    def run(self, task: ShardTask) -> Iterator[SimulationDone | ShardSolved]:
        """Do one shard; yields after each simulation, the last time after the shard is stored, and before it is.

        Raises:
            InputError: no permission, or the store is another sweep's.
            StoreError: the place of the store fails, has no space left, or two sweeps laid the store out.
            OutOfMemoryError: memory is short; the shard is not stored.
            MissingResourceError: the worker's machine or its installation lacks something; the shard is not stored.
        """
        try:
            yield from self._run(task)
        except MemoryError as error:
            raise OutOfMemoryError(
                f"out of memory ({str(error) or type(error).__name__}): use coarser cells, or run fewer processes side "
                "by side"
            ) from error
        except (OSError, ImportError, MissingResourceError) as error:
            if isinstance(error, OSError) and error.errno in NO_ROOM:
                raise MissingResourceError(
                    f"no room is left on a disk of {socket.gethostname()}: make room, in TMPDIR for one", code=DISK_FULL
                ) from error
            raise MissingResourceError(
                f"the worker on {socket.gethostname()} cannot simulate ({type(error).__name__}: {error}): mend that "
                "machine, or leave it out",
                code=WORKER_MACHINE,
            ) from error

    def _run(self, task: ShardTask) -> Iterator[SimulationDone | ShardSolved]:
        solver, writer = self._ready()
        layout = self._configuration.layout
        numbers = layout.shard_simulations(task.shard)
        ended = writer.status(task.shard)
        if ended is not None:  # by another driver of this store, or by this one before it was begun anew
            for number, status in zip(numbers, ended[:: layout.pictures], strict=True):
                word = self._word(number, RowStatus(int(status)), stored=number == numbers[-1])
                yield replace(word, found=True)
            return
        parts: list[ShardRows] = []
        if isinstance(solver, ShardSolver) and not task.one_by_one:
            solver.ahead(shard_requests(task, self._configuration), self._configuration.time_limit_s)
        for number, (status, rows) in zip(numbers, simulate_shard(task, self._configuration, solver), strict=True):
            parts.append(rows)
            self._solves += 1
            stored = len(parts) == len(numbers)
            if stored:
                yield ShardSolved(task.shard)  # a store that makes it wait is no simulation's fault
                if writer.status(task.shard) is None:  # another driver may have been quicker, with the same bits
                    writer.write_shard(task.shard, ShardRows.concatenate(parts))
            yield self._word(number, status, stored=stored)

    def _word(self, number: int, status: RowStatus, *, stored: bool) -> SimulationDone:
        return SimulationDone(number, status, self._solves, socket.gethostname(), os.getpid(), resident_bytes(), stored)

    def _ready(self) -> tuple[Solver | ShardSolver, StoreWriter]:
        """Solver and writer, made by the first shard: what fails there is raised as a task's error, with its cause."""
        if self._solver is None or self._writer is None:
            from simcore.solver import Solver  # in the worker alone: Ray's client server, too, imports this module

            store = Store.open(self._url)
            check_settings(store, self._configuration)
            check_shards(store, self._configuration)
            self._writer = StoreWriter.open(self._url)
            kind, mesh = self._configuration.solver, self._configuration.mesh
            if kind is SolverKind.SINGLE:
                self._solver = Solver(mesh)
            else:
                self._solver = ShardSolver(mesh, kind, self._configuration.simulations_per_shard)
        return self._solver, self._writer


def resident_bytes() -> int:
    """Memory this process holds [byte] (Linux)."""
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
