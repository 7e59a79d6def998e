"""How `drapemeter dataset` runs a sweep: what it would cost, what it says on the way, and its summary."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from services import console
from simcore.errors import MissingResourceError, StoreError

if TYPE_CHECKING:
    from services.dataset.configuration import SweepConfiguration
    from services.dataset.cost import CostEstimate
    from services.dataset.fabrics import FabricTable
    from services.dataset.worker import SimulationDone

HOPELESS = ("store_damaged", "store_layout", "store_schema")
"""Codes of a store that no sweep can finish."""
NOTE_S = 60.0
"""Seconds between two lines of progress where there is no terminal."""


@dataclass(frozen=True)
class Placement:
    """Where and on how many processes a sweep runs; no bit of the store depends on it."""

    address: str | None
    workers: int | None
    recycle_after: int


def say_cost(configuration: SweepConfiguration, workers: int | None, json_output: bool) -> None:
    """Print what a sweep would cost."""
    from services.dataset.cost import estimate_cost
    from simcore.cores import usable_cores

    cost = estimate_cost(configuration, workers or usable_cores())
    if json_output:
        console.emit_json(cost)
    else:
        console.say(describe_cost(cost))


def describe_cost(cost: CostEstimate) -> str:
    """One line for people."""
    return (
        f"{cost.simulations} simulations, {cost.pictures} pictures: about {cost.core_hours:.2g} core hours, "
        f"{cost.hours:.2g} h on {cost.workers} workers, {cost.gigabytes:.2g} GB{f' ({cost.note})' if cost.note else ''}"
    )


class Watch:
    """Follows a sweep: a bar on a terminal, elsewhere (a cluster's log) a line a minute.

    Args:
        bar: the bar, a no-op where there is no terminal.
    """

    def __init__(self, bar: console.ProgressBar) -> None:
        self._bar = bar
        self._total = self._done = self._failed = 0
        self._first = self._noted = 0.0

    def begin(self, cost: CostEstimate) -> None:
        """The sweep starts."""
        console.note(describe_cost(cost))
        self._bar.update(total=cost.simulations)
        self._total, self._noted = cost.simulations, time.monotonic()

    def hear(self, word: SimulationDone) -> None:
        """A simulation is done."""
        now = time.monotonic()
        self._first = self._first or now
        self._done += 1
        self._failed += word.status.label != "ok"
        self._bar.advance()
        if now - self._noted >= NOTE_S and not sys.stderr.isatty():
            self._noted = now
            left = (now - self._first) / self._done * (self._total - self._done)
            console.note(f"{self._done} of {self._total} simulations, {self._failed} failed, {left / 60:.0f} min to go")


def sweep(
    out: str,
    configuration: SweepConfiguration,
    table: FabricTable,
    placement: Placement,
    *,
    resume: bool,
    json_output: bool,
) -> None:
    """Run the sweep under a progress bar and print its summary."""
    from services.dataset.cluster import CLUSTER_LOST
    from services.dataset.sweep import run_sweep
    from services.dataset.worker import DISK_FULL, WORKER_MACHINE

    with console.progress("simulations", total=configuration.layout.simulations) as bar:
        watch = Watch(bar)
        try:
            summary = run_sweep(
                out,
                configuration,
                table,
                resume=resume,
                address=placement.address,
                workers=placement.workers,
                recycle_after=placement.recycle_after,
                listen=watch.hear,
                begin=watch.begin,
            )
        except KeyboardInterrupt:
            console.note(f"{out}: what is done is kept; the same command with --resume goes on")
            raise
        except StoreError as error:
            if error.code in HOPELESS:
                raise
            raise StoreError(f"{error}; what is done is kept, --resume does the rest", code=error.code) from error
        except MissingResourceError as error:
            if error.code in (CLUSTER_LOST, WORKER_MACHINE, DISK_FULL):
                console.note(f"{out}: what is done is kept; the same command with --resume goes on")
            raise
    if json_output:
        console.emit_json(summary)
        return
    failed = sum(summary.failed.values())
    reasons = ", ".join(f"{name} {count}" for name, count in summary.failed.items())
    console.say(f"{summary.samples} samples in {out}, {failed} failed{f' ({reasons})' if failed else ''}")
