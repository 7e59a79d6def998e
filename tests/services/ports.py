"""Ports of the loopback."""

from __future__ import annotations

import secrets
import socket

NOBODYS = range(20000, 32000)
"""Ray's workers listen on 10002 to 19999, and the kernel gives connections 32768 and more: a port of those that is free
now may be taken when a server that was told of it comes up."""


def free_port() -> int:
    """A port that nobody listens on, and that nobody is given who asks for any."""
    for port in secrets.SystemRandom().sample(NOBODYS, 100):
        with socket.socket() as listener:
            try:
                listener.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError(f"no free port among 100 of {NOBODYS}")
