"""The driver's loop: a bounded window of shards on long-lived workers; what dies is done again."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from renderer.store import RowStatus
from services.dataset.configuration import SweepConfiguration
from services.dataset.fabrics import FabricTable
from services.dataset.shard import ShardTask
from services.dataset.worker import ShardWorker, SimulationDone
from simcore.errors import StoreError

MAX_DEATHS = 3
"""Workers that one simulation may take with it before its rows say so."""

POLL_S = 0.5


@dataclass(frozen=True)
class DispatchOptions:
    """How the work is spread; nothing here changes a bit of the store.

    Attributes:
        workers: worker processes, one CPU each.
        recycle_after: simulations after which a worker's process is replaced.
        start_allowance_s: wall-clock seconds for a worker to start, import and compile.
        silence_factor: a simulation silent for this many time limits of wall-clock time is taken for hung.
        gpus_per_worker: share of a GPU each worker asks for.
    """

    workers: int
    recycle_after: int = 2000
    start_allowance_s: float = 180.0
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


class Dispatcher:
    """Runs shards to completion on Ray actors.

    Args:
        url: the store, laid out.
        configuration, fabrics: the sweep.
        options: how to spread it.
        listen: called with each worker's word.
        worker_class: what runs in a worker's process; another one in tests.
    """

    def __init__(
        self,
        url: str,
        configuration: SweepConfiguration,
        fabrics: FabricTable,
        options: DispatchOptions,
        listen: Callable[[SimulationDone], None] = lambda word: None,
        worker_class: type[Any] = ShardWorker,
    ) -> None:
        import ray

        self._url = url
        self._configuration = configuration
        self._fabrics = fabrics
        self._options = options
        self._listen = listen
        self._actor_class = ray.remote(worker_class)
        self._retry: deque[int] = deque()
        self._deaths: Counter[int] = Counter()
        self._shard_deaths: Counter[int] = Counter()
        self._given_up: dict[int, tuple[RowStatus, str]] = {}
        self._running: dict[Any, _Slot] = {}

    def run(self, shards: Iterable[int]) -> None:
        """Work through the shards; returns when all are stored.

        Raises:
            InputError, StoreError: the place of the store fails; what is stored stays, a resumed sweep does the rest.
            StoreError: a shard took worker after worker without getting on.
        """
        import ray

        waiting = iter(shards)
        idle: list[_Slot] = []
        try:
            while True:
                while len(self._running) < self._options.workers:
                    shard = self._retry.popleft() if self._retry else next(waiting, None)
                    if shard is None:
                        break
                    self._start(idle.pop() if idle else self._new_slot(), shard)
                if not self._running:
                    return
                ready, _ = ray.wait(list(self._running), num_returns=1, timeout=POLL_S, fetch_local=False)
                for stream in ready:
                    finished = self._advance(stream)
                    if finished is not None:
                        idle.append(finished)
                self._end_hung()
        finally:
            for slot in [*self._running.values(), *idle]:
                ray.kill(slot.actor)
            self._running.clear()

    def _new_slot(self) -> _Slot:
        actor = self._actor_class.options(
            num_cpus=1, num_gpus=self._options.gpus_per_worker, max_restarts=0
        ).remote(self._url, self._configuration)  # fmt: skip
        return _Slot(actor)

    def _start(self, slot: _Slot, shard: int) -> None:
        layout = self._configuration.layout
        numbers = layout.shard_simulations(shard)
        task = ShardTask(
            shard,
            self._fabrics.parameters([layout.address(number)[0] for number in numbers]),
            {number: self._given_up[number] for number in numbers if number in self._given_up},
        )
        slot.shard, slot.done, slot.heard = shard, 0, time.monotonic()
        self._running[slot.actor.run.remote(task)] = slot

    def _advance(self, stream: Any) -> _Slot | None:
        """Take one word of a worker; the slot is returned when its shard is stored and the worker may go on."""
        import ray

        slot = self._running[stream]
        try:
            word: SimulationDone = ray.get(next(stream))
        except StopIteration:
            del self._running[stream]
            return self._recycled(slot)
        except ray.exceptions.RayTaskError as error:
            del self._running[stream]
            ray.kill(slot.actor)
            raise error.cause from None  # the worker lives and says what is wrong: another try would say the same
        except ray.exceptions.RayError as error:
            del self._running[stream]
            self._lost(slot, RowStatus.CRASHED, f"the worker died ({type(error).__name__})")
            return None
        slot.done += 1
        slot.solves = word.solves
        slot.heard = time.monotonic()
        self._listen(word)
        return None

    def _recycled(self, slot: _Slot) -> _Slot | None:
        import ray

        if slot.solves < self._options.recycle_after:
            return slot
        ray.kill(slot.actor)
        return None

    def _end_hung(self) -> None:
        """Kill workers whose simulation has been silent far beyond its time limit."""
        now = time.monotonic()
        limit = self._options.silence_factor * self._configuration.time_limit_s
        for stream, slot in list(self._running.items()):
            allowance = self._options.start_allowance_s if slot.solves == 0 and slot.done == 0 else 0.0
            if now - slot.heard > limit + allowance:
                del self._running[stream]
                self._lost(slot, RowStatus.TIMED_OUT, f"silent for {limit:.0f} s")

    def _lost(self, slot: _Slot, status: RowStatus, reason: str) -> None:
        """A worker is gone: its shard is done again, by another; a simulation that keeps killing is given up."""
        import ray

        ray.kill(slot.actor)
        numbers = self._configuration.layout.shard_simulations(slot.shard)
        self._shard_deaths[slot.shard] += 1
        if slot.done < len(numbers):
            culprit = numbers[slot.done]
            self._deaths[culprit] += 1
            if self._deaths[culprit] >= MAX_DEATHS:
                self._given_up[culprit] = (status, f"{reason}, {MAX_DEATHS} times")
        if self._shard_deaths[slot.shard] > MAX_DEATHS * (len(numbers) + 1):
            raise StoreError(
                f"shard {slot.shard} took {self._shard_deaths[slot.shard]} workers: {reason}", code="workers_die"
            )
        self._retry.append(slot.shard)
