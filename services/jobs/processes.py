"""Worker processes: their body, and the server's side that keeps them running."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from collections.abc import Callable

import structlog

from services.jobs.child import STOP_GRACE_S
from services.jobs.execute import execute
from services.jobs.task import TaskOutput
from services.settings import Settings

RESPAWN_AFTER_S = 1.0
STORING_S = 5.0
"""Time that a worker has for giving its job back, once the job's process has ended."""

log = structlog.get_logger("drapemeter.serve")


def run_worker(settings: Settings, work: Callable[..., TaskOutput] = execute) -> None:
    """Body of a worker process: works until SIGTERM or its parent's end.

    Args:
        settings: of the service.
        work: does one task, importable in another process.
    """
    from services.db.engine import Database
    from services.jobs.child import ChildProcess
    from services.jobs.worker import JobWorker
    from services.logs import configure_logging

    configure_logging(settings.log_level)
    stopping = threading.Event()
    parent = multiprocessing.parent_process()
    signal.signal(signal.SIGTERM, lambda *_: stopping.set())
    if parent is None:
        signal.signal(signal.SIGINT, lambda *_: stopping.set())
    else:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        threading.Thread(target=_follow, args=(parent, stopping), daemon=True).start()
    database = Database(settings.database)
    runner = ChildProcess("drapemeter-job", log_level=settings.log_level)
    try:
        JobWorker(settings, database, runner, stopping, work).run()
    finally:
        database.close()


def _follow(parent: multiprocessing.process.BaseProcess, stopping: threading.Event) -> None:
    parent.join()
    stopping.set()


class WorkerProcesses:
    """The workers of one server: started, replaced when they die, ended with it.

    Args:
        settings: how many, and everything they need.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._spawn = multiprocessing.get_context("spawn")
        self._processes: list[multiprocessing.process.BaseProcess] = []
        self._closing = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="worker-watch", daemon=True)

    def start(self) -> None:
        """Start all, and watch over them."""
        for _ in range(self._settings.workers):
            self._processes.append(self._launch())
        self._watcher.start()

    def ask_to_end(self) -> None:
        """Let them begin to end, without waiting for it; they can be asked twice."""
        self._closing.set()
        for process in self._processes:
            process.terminate()

    def close(self) -> None:
        """End them: each gives its job back."""
        self._closing.set()
        if self._watcher.is_alive():
            self._watcher.join()
        self.ask_to_end()  # the watcher may have replaced one meanwhile
        deadline = time.monotonic() + self._settings.job_shutdown_grace_s + STOP_GRACE_S + STORING_S
        for process in self._processes:
            process.join(max(0.1, deadline - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()

    def _launch(self) -> multiprocessing.process.BaseProcess:
        process = self._spawn.Process(target=run_worker, args=(self._settings,), name="drapemeter-worker")
        process.start()
        return process

    def _watch(self) -> None:
        while not self._closing.wait(RESPAWN_AFTER_S):
            for index, process in enumerate(self._processes):
                if not process.is_alive():
                    log.error("worker_died", pid=process.pid, exit_code=process.exitcode)
                    try:
                        self._processes[index] = self._launch()
                    except OSError as error:  # no memory or process left at this moment: the next round tries again
                        log.error("worker_not_started", error=str(error))


def run_workers(settings: Settings) -> None:
    """As many workers as the settings say and at least one, without a server, until SIGTERM or SIGINT."""
    if settings.workers <= 1:
        run_worker(settings)
        return
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    workers = WorkerProcesses(settings)
    try:
        workers.start()
        stopping.wait()
    finally:
        workers.close()
