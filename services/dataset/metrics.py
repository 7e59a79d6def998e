"""Counters for Ray's dashboard and its Prometheus end point."""

from __future__ import annotations

import time

from renderer.store import RowStatus
from services.dataset.tally import Tally
from services.dataset.worker import SimulationDone


class SweepMetrics:
    """Counts what workers say; made on the driver after Ray is up."""

    def __init__(self) -> None:
        from ray.util.metrics import Counter, Gauge, Histogram

        self._simulations = Counter(
            "drapemeter_simulations_total", "Simulations by how they ended.", tag_keys=("status",)
        )
        self._shards = Counter("drapemeter_shards_total", "Shards stored.")
        self._retried = Counter(
            "drapemeter_shards_retried_total",
            "Shards done again because their worker died (crashed) or hung (timed_out).",
            tag_keys=("reason",),
        )
        self._memory = Gauge("drapemeter_worker_rss_bytes", "Memory a worker holds.", tag_keys=("worker",))
        self._seconds = Histogram(
            "drapemeter_simulation_seconds",
            "Wall-clock time of a simulation with its pictures.",
            boundaries=[0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0],
        )
        self._last: dict[str, float] = {}
        self._tally = Tally()

    def count(self, word: SimulationDone) -> None:
        """Take one word of a worker."""
        now = time.monotonic()
        worker = f"{word.host}:{word.process_id}"
        last, self._last[worker] = self._last.get(worker), now
        new = self._tally.is_new(word.simulation)
        if word.found:
            return
        if last is not None:
            self._seconds.observe(now - last)
        if new:
            self._simulations.inc(tags={"status": word.status.label})
        self._memory.set(word.rss_bytes, tags={"worker": worker})
        if word.stored:
            self._shards.inc()

    def count_lost(self, status: RowStatus) -> None:
        """A worker was lost and its shard is done again."""
        self._retried.inc(tags={"reason": status.label})
