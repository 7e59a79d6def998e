"""Workers that simulate nothing: they say what a real one would, or misbehave as asked."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

from renderer.store import RowStatus
from services.dataset.configuration import SweepConfiguration
from services.dataset.shard import ShardTask
from services.dataset.worker import ShardSolved, SimulationDone
from simcore.errors import InputError, StoreError


class ObedientWorker:
    """Notes each finished shard as a file with the statuses of its simulations; ``url`` is a folder."""

    def __init__(self, url: str, configuration: SweepConfiguration) -> None:
        self.folder = Path(url)
        self.configuration = configuration
        self.solves = 0

    def run(self, task: ShardTask) -> Iterator[SimulationDone | ShardSolved]:
        """One word a simulation, as :class:`services.dataset.worker.ShardWorker`."""
        numbers = self.configuration.layout.shard_simulations(task.shard)
        statuses = []
        for number in numbers:
            status = RowStatus.OK
            if number in task.given_up:
                status = task.given_up[number][0]
            else:
                self.simulate(number)
            statuses.append(status)
            self.solves += 1
            if number == numbers[-1]:
                (self.folder / f"{task.shard}").write_text(" ".join(s.label for s in statuses))
            yield SimulationDone(number, status, self.solves, "here", os.getpid(), 0, number == numbers[-1])

    def simulate(self, number: int) -> None:
        """Nothing to do."""


class DyingWorker(ObedientWorker):
    """Simulation 4 kills the process, always; simulation 10 only the first time."""

    def simulate(self, number: int) -> None:
        """Die or go on."""
        first_time = not (self.folder / "10-tried").exists()
        if number == 10:
            (self.folder / "10-tried").touch()
        if number == 4 or (number == 10 and first_time):
            os.kill(os.getpid(), signal.SIGKILL)


class DyingTogetherWorker(ObedientWorker):
    """Solves shards ahead; simulation 4 kills the process, always, and the shard of simulation 10 does so twice."""

    def run(self, task: ShardTask) -> Iterator[SimulationDone | ShardSolved]:
        """Die, or go on as the others."""
        numbers = self.configuration.layout.shard_simulations(task.shard)
        tries = self.folder / "tries"
        ahead = not task.one_by_one
        if ahead and 10 in numbers and (not tries.exists() or tries.stat().st_size < 2):
            with tries.open("a") as file:
                file.write(".")
            os.kill(os.getpid(), signal.SIGKILL)
        if ahead and 4 in numbers:
            os.kill(os.getpid(), signal.SIGKILL)
        yield from super().run(task)

    def simulate(self, number: int) -> None:
        """Die or go on."""
        if number == 4:
            os.kill(os.getpid(), signal.SIGKILL)


class HangingWorker(ObedientWorker):
    """Simulation 7 never ends."""

    def simulate(self, number: int) -> None:
        """Hang or go on."""
        if number == 7:
            time.sleep(3600)


class SlowStoreWorker(ObedientWorker):
    """The store of the third shard keeps it waiting, or kills it once, when all of it is simulated."""

    seconds = 15.0

    def run(self, task: ShardTask) -> Iterator[SimulationDone | ShardSolved]:
        """As the others, with a word before storing."""
        for word in super().run(task):
            if isinstance(word, SimulationDone) and word.stored:
                yield ShardSolved(task.shard)
                if task.shard == 2:
                    self.store()
            yield word

    def store(self) -> None:
        """Wait."""
        time.sleep(self.seconds)


class DyingStoreWorker(SlowStoreWorker):
    """Storing the third shard kills the process, three times."""

    def store(self) -> None:
        """Die or go on."""
        tries = self.folder / "stored-tries"
        if not tries.exists() or tries.stat().st_size < 3:
            with tries.open("a") as file:
                file.write(".")
            os.kill(os.getpid(), signal.SIGKILL)


class FullDiskWorker(ObedientWorker):
    """The third shard finds no space."""

    def simulate(self, number: int) -> None:
        """Fail or go on."""
        if number == 6:
            raise StoreError("store: no space is left", code="store_no_space")


class FaultyWorker(ObedientWorker):
    """Every shard meets a fault of the program."""

    def simulate(self, number: int) -> None:
        """Fail."""
        raise KeyError("a fault of the program")


def refuse(item: int) -> int:
    """A piece of work that cannot be done."""
    raise InputError(f"{item} is refused", code="refused_here")
