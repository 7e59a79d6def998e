"""How long a download of weights waits for a machine that does not answer."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

CONNECT_TIMEOUT_S = 15.0


@contextmanager
def connect_timeout(seconds: float = CONNECT_TIMEOUT_S) -> Iterator[None]:
    """Within it, sockets that are opened give up after so long without an answer; by themselves they wait for ever."""
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(seconds)
    try:
        yield
    finally:
        socket.setdefaulttimeout(before)
