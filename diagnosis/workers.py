"""Fabrics side by side, in processes of their own where there is more than one worker."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_context
from types import TracebackType
from typing import TypeVar

from simcore.errors import SimulationError
from simcore.parent import end_with_parent

Given = TypeVar("Given")
Made = TypeVar("Made")


class Workers:
    """Processes that are started when first needed; with one worker, the calling process.

    Unlike those of :mod:`metric.workers` they stay for several rounds, so that each compiles its kernels once.
    A context manager: the processes end with it, at once where it is left by an exception, and with this process.
    """

    def __init__(self, count: int = 1) -> None:
        self.count = count
        self._pool: ProcessPoolExecutor | None = None
        self._others: frozenset[int | None] = frozenset()

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            for process in active_children() if kind is not None else ():
                if process.pid not in self._others:
                    process.terminate()
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def map(
        self, work: Callable[[Given], Made], items: Sequence[Given], on_done: Callable[[float], None] | None = None
    ) -> list[Made]:
        """What ``work`` makes of every item, in their order, each in one numerical thread.

        Args:
            work: a function that can be pickled (as can items and what is made) where there are several workers.
            items: one for each call.
            on_done: called with 1 for every item that is done.

        Raises:
            SimulationError: a process died.
            Exception: whatever ``work`` raised.
        """
        told = on_done or (lambda _: None)
        if self.count <= 1 or len(items) <= 1:
            made = []
            for item in items:
                made.append(_one_thread(work, item))
                told(1.0)
            return made
        if self._pool is None:
            self._others = frozenset(process.pid for process in active_children())
            self._pool = ProcessPoolExecutor(self.count, mp_context=get_context("spawn"), initializer=end_with_parent)
        try:
            futures = [self._pool.submit(_one_thread, work, item) for item in items]
            for _ in as_completed(futures):
                told(1.0)
            return [future.result() for future in futures]
        except BrokenProcessPool:
            raise SimulationError(
                "a worker process died: the machine may be out of memory; "
                "try fewer --workers or a coarser --resolution",
                code="worker_died",
            ) from None


def _one_thread(work: Callable[[Given], Made], item: Given) -> Made:
    """Matrices here are small, and workers have the other cores: more threads cost more than they give."""
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # it ships no type information

    with threadpool_limits(1):
        return work(item)


ALONE = Workers(1)
"""The calling process."""
