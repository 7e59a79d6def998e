"""A TCP proxy on the loopback that breaks connections on purpose."""

from __future__ import annotations

import random
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

BUSY = b"HTTP/1.1 503 Slow Down\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
FORBIDDEN = (
    b"HTTP/1.1 403 Forbidden\r\nContent-Type: application/xml\r\nContent-Length: 61\r\nConnection: close\r\n\r\n"
    b"<Error><Code>InvalidAccessKeyId</Code><Message/></Error>     "
)


class FaultProxy:
    """Forwards to a server on the loopback.

    Attributes:
        fault_share: share of connections that are answered "503 Slow Down" or cut after some bytes.
        forbidding: every request is answered "403 Forbidden".
        down: nothing is answered, open connections are cut.
        faults: faults so far.
    """

    def __init__(self, target: int, fault_share: float = 0.0, seed: int = 0) -> None:
        self.target = target
        self.fault_share = fault_share
        self.forbidding = False
        self.faults = 0
        self._down = False
        self._random = random.Random(seed)
        self._open: set[socket.socket] = set()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._accepting = threading.Thread(target=self._accept, daemon=True)
        self._accepting.start()

    @property
    def down(self) -> bool:
        """Whether the server is gone."""
        return self._down

    @down.setter
    def down(self, value: bool) -> None:
        self._down = value
        if value:
            for connection in list(self._open):
                close(connection)

    def stop(self) -> None:
        """End all connections and listen no more."""
        self.down = True
        self._listener.shutdown(socket.SHUT_RDWR)  # closing alone does not wake the thread that waits
        self._listener.close()
        self._accepting.join()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            if self._down:
                self.faults += 1
                client.close()
                continue
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        refusal = FORBIDDEN if self.forbidding else None
        limit = self._random.randrange(3_000, 60_000)  # a kept-alive connection meets a fault sooner or later
        if self._random.random() < self.fault_share:
            self.faults += 1
            refusal, limit = self._random.choice([(BUSY, 0), (refusal, self._random.randrange(1, 3000))])
        if refusal is not None:
            client.recv(65536)
            client.sendall(refusal)
            client.close()
            return
        server = socket.create_connection(("127.0.0.1", self.target))
        self._open |= {client, server}
        if not self.fault_share:
            limit = 2**62
        other = threading.Thread(target=self._pump, args=(client, server, 2**62), daemon=True)
        other.start()
        self._pump(server, client, limit)

    def _pump(self, source: socket.socket, sink: socket.socket, limit: int) -> None:
        try:
            while limit > 0 and (data := source.recv(min(65536, limit))):
                limit -= len(data)
                sink.sendall(data)
            self.faults += limit == 0
        except OSError:
            self.faults += 1
        close(source)
        close(sink)
        self._open -= {source, sink}


def close(connection: socket.socket) -> None:
    """Cut a connection at once."""
    try:
        connection.shutdown(socket.SHUT_RDWR)
    except OSError:
        return
    finally:
        connection.close()


@contextmanager
def fault_proxy(target: int, fault_share: float = 0.0) -> Iterator[FaultProxy]:
    """A proxy until the end of the block."""
    proxy = FaultProxy(target, fault_share)
    try:
        yield proxy
    finally:
        proxy.stop()
