"""The server process: uvicorn, and the workers beside it."""

from __future__ import annotations

import signal
from types import FrameType

import structlog
import uvicorn

from services.api.app import create_app
from services.api.keys import any_key
from services.db.engine import Database
from services.jobs.processes import WorkerProcesses
from services.settings import Settings

SHUTDOWN_S = 10
log = structlog.get_logger("drapemeter.serve")


def run_server(settings: Settings) -> None:
    """Serve until SIGTERM or Ctrl-C; requests under way are finished, jobs are given back."""
    _say_who_may_come(settings)
    workers = WorkerProcesses(settings)
    config = uvicorn.Config(
        create_app(settings),
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=SHUTDOWN_S,
        timeout_keep_alive=30,
    )
    server = uvicorn.Server(config)

    def leave(_signal: int, _frame: FrameType | None) -> None:
        server.should_exit = True

    # uvicorn raises the signal again once it has ended; with the default handlers we would end before our workers.
    signal.signal(signal.SIGTERM, leave)
    signal.signal(signal.SIGINT, leave)
    workers.start()
    try:
        server.run()
    finally:
        workers.close()


def _say_who_may_come(settings: Settings) -> None:
    database = Database(settings.database)
    with database.read() as session:
        keys = any_key(session)
    if not keys and not settings.guarded:
        log.warning(
            "open_to_this_machine", detail="no API key exists: every program on this machine may use the server"
        )
    elif not keys:
        log.warning("no_api_key", detail="every request is refused until 'drapemeter keys create' has made a key")
    log.info("serving", host=settings.host, port=settings.port, database=database.public_url, workers=settings.workers)
    database.close()
