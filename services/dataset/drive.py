"""The driver's loop in this process, or, behind Ray's client, as a task on the cluster itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from services.dataset.cluster import CLUSTER_LOST
from services.dataset.configuration import SweepConfiguration
from services.dataset.dispatch import Dispatcher, DispatchOptions
from services.dataset.fabrics import FabricTable
from services.dataset.metrics import SweepMetrics
from services.dataset.worker import SimulationDone
from simcore.errors import MissingResourceError

POLL_S = 1.0
Listener = Callable[[SimulationDone], None]


@dataclass(frozen=True)
class Drive:
    """All that the driver's loop needs.

    Attributes:
        url: the store, laid out.
        configuration, fabrics: the sweep.
        options: how it is spread.
        shards: which are still to be done.
    """

    url: str
    configuration: SweepConfiguration
    fabrics: FabricTable
    options: DispatchOptions
    shards: list[int]

    def run(self, listen: Listener) -> None:
        """Run the loop in this process, which Ray must know as a driver or a worker.

        Raises:
            InputError, StoreError: see :class:`~services.dataset.dispatch.Dispatcher`.
        """
        metrics = SweepMetrics()

        def hear(word: SimulationDone) -> None:
            metrics.count(word)
            listen(word)

        dispatcher = Dispatcher(self.url, self.configuration, self.fabrics, self.options, hear, lost=metrics.count_lost)
        dispatcher.run(self.shards)

    def run_on_cluster(self, listen: Listener) -> None:
        """Run the loop as a task: Ray's client (``ray://``) cannot follow the workers' words itself.

        Raises:
            InputError, StoreError: as :meth:`run`.
            MissingResourceError: the cluster loses what drives the sweep again and again.
        """
        import ray

        # both begun anew where a machine is lost: workers pass over what is stored, and words say only how far it is
        mailbox: Any = ray.remote(Mailbox).options(num_cpus=0, max_restarts=-1, max_task_retries=-1).remote()
        loop = ray.remote(_loop).options(num_cpus=0, max_retries=3).remote(self, mailbox)
        finished: list[Any] = []
        try:
            while not finished:
                finished, _ = ray.wait([loop], timeout=POLL_S)
                for word in ray.get(mailbox.take.remote()):
                    listen(word)
            ray.get(loop)
        except ray.exceptions.RayTaskError as error:
            raise error.cause from None
        except ray.exceptions.RaySystemError:
            raise  # the cluster itself went away
        except ray.exceptions.RayError as error:
            raise MissingResourceError(
                f"what drives the sweep was lost on the cluster ({type(error).__name__})", code=CLUSTER_LOST
            ) from None


class Mailbox:
    """Words on their way from the loop to whoever listens; an actor."""

    def __init__(self) -> None:
        self._words: list[SimulationDone] = []

    def put(self, word: SimulationDone) -> None:
        """Add a word."""
        self._words.append(word)

    def take(self) -> list[SimulationDone]:
        """All words since the last call."""
        words, self._words = self._words, []
        return words


def _loop(drive: Drive, mailbox: Any) -> None:
    drive.run(lambda word: mailbox.put.remote(word))
