"""A function over many items in worker processes that never outlive the work."""

from __future__ import annotations

import multiprocessing
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Generic, TypeVar

from simcore.errors import DrapemeterError, SimulationError
from simcore.parent import end_with_parent

Item = TypeVar("Item")
Result = TypeVar("Result")

_LEAVE_S = 5.0


@dataclass
class _Worker(Generic[Item]):
    process: SpawnProcess
    pipe: Connection

    def give(self, item: Item) -> None:
        self.pipe.send(item)


def run_in_processes(work: Callable[[Item], Result], items: Sequence[Item], count: int) -> Iterator[Result]:
    """Results in the order in which they are ready.

    Workers are spawned (the child of a fork hangs in Taichi): one worker = one process = one Taichi runtime. When the
    iteration ends in whatever way, Ctrl-C included, they are stopped at once; they end with this process if it is
    killed.

    Args:
        work: a module's function.
        items: what to call it with; picklable, as the results.
        count: processes.

    Raises:
        SimulationError: a worker died.
        Exception: whatever ``work`` raised.
    """
    context = multiprocessing.get_context("spawn")
    queue = list(reversed(items))
    workers: dict[Connection, _Worker[Item]] = {}
    try:
        for _ in range(min(count, len(items))):
            mine, theirs = context.Pipe()
            process = context.Process(target=_serve, args=(theirs, work), daemon=True)
            process.start()
            theirs.close()
            workers[mine] = _Worker(process, mine)
        for worker in workers.values():
            worker.give(queue.pop())
        busy = set(workers)
        while busy:
            for pipe in [p for p in wait(list(busy)) if isinstance(p, Connection)]:
                yield _receive(workers[pipe])
                if queue:
                    workers[pipe].give(queue.pop())
                else:
                    busy.discard(pipe)
    finally:
        for worker in workers.values():
            worker.pipe.close()
            worker.process.terminate()
        for worker in workers.values():
            worker.process.join(_LEAVE_S)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()


def _receive(worker: _Worker[Any]) -> Any:
    try:
        result, error = worker.pipe.recv()
    except (EOFError, ConnectionResetError):
        worker.process.join(_LEAVE_S)
        raise SimulationError(
            f"a worker process died (exit code {worker.process.exitcode}): the machine may be out of memory; "
            "try fewer --workers or a coarser --resolution",
            code="worker_died",
        ) from None
    if error is not None:
        raise error
    return result


def _serve(pipe: Connection, work: Callable[[Any], Any]) -> None:
    """The worker: items in, results out, until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears Ctrl-C and stops its workers
    end_with_parent()
    while True:
        try:
            item = pipe.recv()
        except (EOFError, ConnectionResetError):
            return
        answer: tuple[Any, BaseException | None]
        try:
            answer = (work(item), None)
        except DrapemeterError as error:
            answer = (None, error)
        except Exception:  # noqa: BLE001  the process's outermost frame: the parent raises what happened here
            answer = (None, RuntimeError(f"in a worker process:\n{traceback.format_exc()}"))
        try:
            pipe.send(answer)
        except (BrokenPipeError, ConnectionResetError):
            return
