"""The driver's loop: a bounded window of shards on long-lived workers; what dies is done again."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from renderer.store import RowStatus
from services.dataset.cluster import LOGS
from services.dataset.configuration import SweepConfiguration
from services.dataset.fabrics import FabricTable
from services.dataset.shard import ShardTask
from services.dataset.solver_kind import SolverKind
from services.dataset.worker import ShardSolved, ShardWorker, SimulationDone
from simcore.errors import OutOfMemoryError, StoreError

MAX_DEATHS = 3
"""Workers that one simulation may take with it before its rows say so."""

MAX_SHORT = 3
"""Times that a shard may find too little memory."""

MAX_STILLBORN = 10
"""Workers that may die before they start, one after the other; as many as are wanted where these are more, since a
machine may be lost with all it starts."""

POLL_S = 0.5

STORING_REQUESTS = 20
"""A store that is slow may make each request that stores a shard wait as long as requests are repeated."""

LEAST_SILENCE_S = 10.0
"""However short the time limit is, a simulation has this long to be told of."""


@dataclass(frozen=True)
class DispatchOptions:
    """How the work is spread; nothing here changes a bit of the store.

    Attributes:
        workers: worker processes, one CPU each.
        recycle_after: simulations after which a worker's process is replaced.
        compile_allowance_s: wall-clock seconds more for a worker's first simulation, which compiles.
        start_allowance_s: wall-clock seconds without any worker after which the sweep ends.
        silence_factor: a simulation silent for this many time limits of wall-clock time is taken for hung.
        gpus_per_worker: share of a GPU each worker asks for.
    """

    workers: int
    recycle_after: int = 2000
    compile_allowance_s: float = 180.0
    start_allowance_s: float = 900.0
    silence_factor: float = 4.0
    gpus_per_worker: float = 0.0


@dataclass
class _Slot:
    """One worker and the shard it works on."""

    actor: Any
    solves: int = 0
    shard: int = -1
    done: int = 0
    heard: float = 0.0
    storing: bool = False


class Dispatcher:
    """Runs shards to completion on Ray actors.

    Args:
        url: the store, laid out.
        configuration, fabrics: the sweep.
        options: how to spread it.
        listen: called with each worker's word.
        worker_class: what runs in a worker's process; another one in tests.
        lost: called when a worker died, hung or found too little memory, and its shard is done again: with
            ``TIMED_OUT`` where it hung, else ``CRASHED``.
    """

    def __init__(
        self,
        url: str,
        configuration: SweepConfiguration,
        fabrics: FabricTable,
        options: DispatchOptions,
        listen: Callable[[SimulationDone], None] = lambda word: None,
        worker_class: type[Any] = ShardWorker,
        lost: Callable[[RowStatus], None] = lambda status: None,
    ) -> None:
        import ray

        self._url = url
        self._configuration = configuration
        self._fabrics = fabrics
        self._options = options
        self._listen = listen
        self._tell_lost = lost
        self._actor_class = ray.remote(worker_class)
        self._retry: deque[int] = deque()
        self._deaths: Counter[int] = Counter()
        self._shard_deaths: Counter[int] = Counter()
        self._short: Counter[int] = Counter()
        self._given_up: dict[int, tuple[RowStatus, str]] = {}
        self._running: dict[Any, _Slot] = {}
        self._starting: dict[Any, _Slot] = {}
        self._idle: list[_Slot] = []
        self._ahead: int | None = None
        self._stillborn = 0
        self._heard = 0.0

    def run(self, shards: Iterable[int]) -> None:
        """Work through the shards; returns when all are stored.

        Raises:
            InputError, StoreError: the place of the store fails; what is stored stays, a resumed sweep does the rest.
            StoreError: a shard took worker after worker without getting on or found too little memory again and again,
                or no worker comes up.
        """
        import ray

        waiting = iter(shards)
        self._heard = time.monotonic()
        try:
            while True:
                self._hand_out(waiting)
                if not self._running and not self._retry and self._ahead is None:
                    return
                watched = [*self._running, *self._starting]
                ray.wait(watched, num_returns=1, timeout=POLL_S, fetch_local=False)
                # With hundreds of workers several have something to say by now: take all of it.
                ready, _ = ray.wait(watched, num_returns=len(watched), timeout=0, fetch_local=False)
                for event in ready:
                    if event in self._starting:
                        self._came_up(event)
                    else:
                        self._advance(event)
                self._end_hung()
        finally:
            for slot in [*self._running.values(), *self._starting.values(), *self._idle]:
                ray.kill(slot.actor)

    def _hand_out(self, waiting: Iterator[int]) -> None:
        """Keep the workers' number up, and give those that are up a shard each; one that is not up holds none."""
        while True:
            if self._ahead is None:
                self._ahead = self._retry.popleft() if self._retry else next(waiting, None)
            if self._ahead is None:
                return
            if not self._idle:
                break
            self._start(self._idle.pop(), self._ahead)
            self._ahead = None
        while len(self._running) + len(self._starting) < self._options.workers:
            actor = self._actor_class.options(
                num_cpus=1, num_gpus=self._options.gpus_per_worker, max_restarts=0
            ).remote(self._url, self._configuration)  # fmt: skip
            self._starting[actor.__ray_ready__.remote()] = _Slot(actor)

    def _came_up(self, event: Any) -> None:
        """A new worker answers, or died before it could."""
        import ray

        slot = self._starting.pop(event)
        try:
            ray.get(event)
        except ray.exceptions.RayError as error:
            self._stillborn += 1
            if self._stillborn > max(MAX_STILLBORN, self._options.workers):
                raise StoreError(f"workers die before they start: {error}", code="workers_die") from None
            return
        self._stillborn = 0
        self._heard = time.monotonic()
        self._idle.append(slot)

    def _start(self, slot: _Slot, shard: int) -> None:
        layout = self._configuration.layout
        numbers = layout.shard_simulations(shard)
        task = ShardTask(
            shard,
            self._fabrics.parameters([layout.address(number)[0] for number in numbers]),
            {number: self._given_up[number] for number in numbers if number in self._given_up},
            one_by_one=self._one_by_one(shard),
        )
        slot.shard, slot.done, slot.heard, slot.storing = shard, 0, time.monotonic(), False
        run = slot.actor.run
        if self._shard_deaths[shard]:
            # A word still on its way when its worker dies is lost, and the death would be charged to a simulation that
            # was done. Where a worker has died before, the next simulation waits until the last one's word is taken.
            run = run.options(_generator_backpressure_num_objects=1)
        self._running[run.remote(task)] = slot

    def _one_by_one(self, shard: int) -> bool:
        """Whether it is to be found out which simulation of a shard kills the workers that solve it together."""
        return self._shard_deaths[shard] >= MAX_DEATHS

    def _advance(self, stream: Any) -> None:
        """Take one word of a worker."""
        import ray

        slot = self._running[stream]
        try:
            word: SimulationDone | ShardSolved = ray.get(next(stream))
        except StopIteration:
            del self._running[stream]
            if slot.solves < self._options.recycle_after:
                self._idle.append(slot)
            else:
                ray.kill(slot.actor)
            return
        except ray.exceptions.RayTaskError as error:
            del self._running[stream]
            ray.kill(slot.actor)
            if not isinstance(error.cause, OutOfMemoryError):
                raise error.cause from None  # the worker lives and says what is wrong: another try would say the same
            self._lacked_memory(slot.shard, error.cause)
            return
        except ray.exceptions.OutOfMemoryError as error:  # Ray's own word, where it ended the worker before memory did
            del self._running[stream]
            ray.kill(slot.actor)
            self._lacked_memory(slot.shard, error)
            return
        except ray.exceptions.RayError as error:
            del self._running[stream]
            self._lost(slot, RowStatus.CRASHED, f"the worker died ({type(error).__name__})")
            return
        slot.heard = self._heard = time.monotonic()
        if isinstance(word, ShardSolved):
            slot.storing = True
            return
        slot.done += 1
        slot.solves = word.solves
        if word.found and self._shard_deaths[slot.shard]:  # by a worker of this run, which was lost before it said so
            word = replace(word, found=False)
        self._listen(word)

    def _lacked_memory(self, shard: int, error: Exception) -> None:
        """A shard found too little memory: it is done again, by another worker, since others may leave more by then."""
        self._tell_lost(RowStatus.CRASHED)
        self._short[shard] += 1
        if self._short[shard] >= MAX_SHORT:
            raise StoreError(f"shard {shard} was tried {MAX_SHORT} times: {error}", code="out_of_memory")
        self._retry.append(shard)

    def _end_hung(self) -> None:
        """Kill workers whose simulation has been silent far beyond its time limit."""
        from renderer.store_remote import patience_s

        now = time.monotonic()
        limit = max(LEAST_SILENCE_S, self._options.silence_factor * self._configuration.time_limit_s)
        together = limit  # it is silent until all of a shard are solved
        if self._configuration.solver is not SolverKind.SINGLE:
            together *= self._configuration.simulations_per_shard
        for stream, slot in list(self._running.items()):
            allowance = self._options.compile_allowance_s if slot.solves == 0 else 0.0
            if slot.storing:
                allowance = STORING_REQUESTS * patience_s()
            allowance += together if slot.done == 0 and not self._one_by_one(slot.shard) else limit
            if now - slot.heard > allowance:
                del self._running[stream]
                self._lost(slot, RowStatus.TIMED_OUT, f"silent for {allowance:.0f} s")
        if not self._running and not self._idle and now - self._heard > self._options.start_allowance_s:
            raise StoreError(
                f"no worker has come up in {self._options.start_allowance_s:.0f} s: the cluster has no free CPU, or "
                f"cannot start a process ({LOGS} on its machines say why)",
                code="workers_missing",
            )

    def _lost(self, slot: _Slot, status: RowStatus, reason: str) -> None:
        """A worker is gone: its shard is done again, by another; a simulation that keeps killing is given up."""
        import ray

        ray.kill(slot.actor)
        self._tell_lost(status)
        numbers = self._configuration.layout.shard_simulations(slot.shard)
        self._shard_deaths[slot.shard] += 1
        if slot.storing:
            slot.done = len(numbers)  # nobody's fault: its simulations are done
        together = self._configuration.solver is not SolverKind.SINGLE
        if together and slot.done == 0 and self._shard_deaths[slot.shard] <= MAX_DEATHS:
            pass  # it died solving the whole shard: of nobody yet, and of the same bits when done again
        elif slot.done < len(numbers):
            culprit = numbers[slot.done]
            self._deaths[culprit] += 1
            if self._deaths[culprit] >= MAX_DEATHS:
                self._given_up[culprit] = (status, f"{reason}, {MAX_DEATHS} times")
        if self._shard_deaths[slot.shard] > MAX_DEATHS * (len(numbers) + 1):
            raise StoreError(
                f"shard {slot.shard} took {self._shard_deaths[slot.shard]} workers: {reason}", code="workers_die"
            )
        self._retry.append(slot.shard)
