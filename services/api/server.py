"""The server process: uvicorn, and the workers beside it."""

from __future__ import annotations

import signal
import socket
from collections.abc import Callable
from types import FrameType

import structlog
import uvicorn

from services.api.app import create_app
from services.api.keys import any_key
from services.api.state import ServiceState
from services.db.engine import Database
from services.jobs.processes import WorkerProcesses
from services.settings import Settings
from simcore.errors import InputError

SHUTDOWN_S = 10
"""How long requests under way may take still once the server is asked to end [s]; then they are cut off."""
ESTIMATES_END_S = 8.0
"""The same for estimates: before they are cut off, so that whoever waits is told."""
log = structlog.get_logger("drapemeter.serve")


def run_server(settings: Settings, on_listening: Callable[[str], None] | None = None) -> None:
    """Serve until SIGTERM or Ctrl-C; requests under way are finished, jobs are given back.

    Args:
        settings: of the service.
        on_listening: called with the address once it takes connections.

    Raises:
        InputError: it cannot listen there.
    """
    _say_who_may_come(settings)
    workers = WorkerProcesses(settings)
    listener = open_listener(settings.host, settings.port)
    app = create_app(settings)
    service: ServiceState = app.state.service
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=SHUTDOWN_S,
        timeout_keep_alive=30,
    )

    def ask_to_end() -> None:
        workers.ask_to_end()
        service.inference.ask_to_end(ESTIMATES_END_S)

    server = _Server(config, ask_to_end)

    def leave(_signal: int, _frame: FrameType | None) -> None:
        server.should_exit = True
        ask_to_end()

    # While it serves uvicorn has handlers of its own, see below. It raises the signal again once it has ended; with the
    # default handlers we would end before our workers.
    signal.signal(signal.SIGTERM, leave)
    signal.signal(signal.SIGINT, leave)
    try:
        workers.start()
        log.info("listening", url=url_of(listener))
        if on_listening is not None:
            on_listening(url_of(listener))
        server.run(sockets=[listener])
    finally:
        listener.close()
        service.close()  # a second Ctrl-C passes over the application's own end
        workers.close()


class _Server(uvicorn.Server):
    """Tells workers and estimates of a signal at once: whoever stops us may not wait until requests and then jobs
    have ended.
    """

    def __init__(self, config: uvicorn.Config, ask_to_end: Callable[[], None]) -> None:
        super().__init__(config)
        self._ask_to_end = ask_to_end

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """See :class:`uvicorn.Server`."""
        self._ask_to_end()
        super().handle_exit(sig, frame)


def open_listener(host: str, port: int) -> socket.socket:
    """A bound socket, before anything else is started.

    Raises:
        InputError: the address is none or not this machine's, or the port is taken or not allowed.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(address[:2], family=family)
    except (OSError, UnicodeError) as error:  # the latter where a name's labels are empty or too long
        why = error.strerror or error if isinstance(error, OSError) else "no name of a host"
        raise InputError(
            f"cannot listen at {host} port {port} ({why}): choose others with --host and --port", code="cannot_listen"
        ) from None


def url_of(listener: socket.socket) -> str:
    """Where to reach it."""
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


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
