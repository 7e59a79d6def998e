"""Ray: a quiet local cluster, or a running one by its address."""

from __future__ import annotations

import os
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from simcore.cores import usable_cores
from simcore.errors import InputError, MissingResourceError

_STORE_BYTES = 100 * 2**20
"""Ray's object store: only keys and small words travel through it, data goes to the Zarr store."""

_QUIET: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False}
_CLIENT_ATTEMPTS = 3
CLUSTER_LOST = "cluster_lost"
"""Code of a cluster that went away while it was at work."""
_PROBE_S = 5.0
LOGS = "/tmp/ray/session_latest/logs"
"""Where Ray tells what became of its processes, unless RAY_TMPDIR names another folder."""


@contextmanager
def ray_cluster(address: str | None, workers: int | None, *, gpus: bool = False) -> Iterator[int]:
    """Ray for the length of the block; the number of workers to use is given.

    Args:
        address: ``auto``, ``host:port`` or ``ray://...`` of a running cluster (its store must be reachable from every
            node); None takes ``RAY_ADDRESS``, else starts a cluster on this machine that ends with the block.
        workers: None takes every CPU of the cluster, or all that this process may use; with ``gpus`` every GPU.
        gpus: workers need one GPU each.

    Raises:
        InputError: no cluster at the address, it wants a token, it has no GPU where one is needed, or the temporary
            folder or that of the environment is none for Ray.
        MissingResourceError: the cluster went away within the block.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    import ray

    address = address or os.environ.get("RAY_ADDRESS") or "local"
    cores = usable_cores()
    if is_local(address):
        # Ray's workers look for modules in the folder where it was started, and before all others: it may have a
        # `metric.py` of somebody else's.
        _name_folders_whole()
        interpreter = _interpreter()
        with chdir(Path(__file__).parents[2]), _own_sigterm(), _folder_told():
            ray.init(
                address="local",
                num_cpus=workers or cores,
                num_gpus=None if gpus else 0,  # None: as many as the machine has
                include_dashboard=False,
                object_store_memory=_STORE_BYTES,
                _node_ip_address="127.0.0.1",
                runtime_env=interpreter,
                **_QUIET,
            )
    else:
        _connect(address)
        cores = max(1, int(cluster_cpus()))
    try:
        yield min(workers or cores, _gpus()) if gpus else workers or cores
    except (ConnectionError, ray.exceptions.RaySystemError) as error:
        if is_local(address):
            raise
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise MissingResourceError(
            f"the Ray cluster at {_named(address)} went away ({why}): start it again, then the command",
            code=CLUSTER_LOST,
        ) from None
    finally:
        ray.shutdown()


@contextmanager
def _own_sigterm() -> Iterator[None]:
    """Whatever SIGTERM does here it does afterwards, too: Ray, which takes it for itself, aborts a process of it."""
    own = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if own not in (None, signal.SIG_DFL) and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, own)


@contextmanager
def _folder_told() -> Iterator[None]:
    """Tell of a temporary folder in which Ray cannot make its sockets.

    Raises:
        InputError: its name is too long, or has other letters than ASCII.
    """
    try:
        yield
    except (OSError, UnicodeError) as error:
        if not isinstance(error, UnicodeError) and "AF_UNIX" not in str(error):
            raise
        folder = os.environ.get("RAY_TMPDIR") or tempfile.gettempdir()
        raise InputError(
            f"Ray cannot make its sockets in {folder} ({error}): set RAY_TMPDIR to a folder with a short name of plain "
            "letters, such as /tmp",
            code="ray_folder",
        ) from None


def _interpreter() -> dict[str, str] | None:
    """What Ray must be told of an interpreter whose path a shell takes apart, as at a blank: it hands it to one.

    Raises:
        InputError: the node's own program, which reads its command with the rules of a shell, cannot read it.
    """
    path = sys.executable
    if shlex.quote(path) == path:
        return None
    try:
        if shlex.split(subprocess.list2cmdline([path])) == [path]:  # as Ray writes that command
            return {"py_executable": shlex.quote(path)}
    except ValueError:  # a quotation mark without its second
        pass
    raise InputError(
        f"Ray cannot start {path}: set the environment up in a folder without quotation marks and backslashes in its "
        "name",
        code="ray_interpreter",
    )


def _name_folders_whole() -> None:
    """Let what the environment names be the same folders for workers, which are in another one."""
    for name in ("DRAPEMETER_CACHE", "DRAPEMETER_KERNEL_CACHE", "DRAPEMETER_WEIGHTS", "XDG_CACHE_HOME"):
        if os.environ.get(name):
            os.environ[name] = str(Path(os.environ[name]).absolute())


def is_local(address: str | None) -> bool:
    """Whether the work is done by a cluster of its own on this machine."""
    return (address or os.environ.get("RAY_ADDRESS") or "local") == "local"


def _connect(address: str) -> None:
    """Join a running cluster."""
    import ray

    _knock(address)
    for attempt in range(1, _CLIENT_ATTEMPTS + 1):
        try:
            with _own_sigterm():
                ray.init(address=address, **_QUIET)
        except ray.exceptions.AuthenticationError:
            raise InputError(
                f"the Ray cluster at {_named(address)} wants its token: set RAY_AUTH_MODE=token and RAY_AUTH_TOKEN",
                code="cluster_token",
            ) from None
        except (ConnectionError, ValueError, RuntimeError) as error:
            # A busy head node takes longer to start a client's server than Ray's client waits.
            if isinstance(error, ConnectionAbortedError) and attempt < _CLIENT_ATTEMPTS:
                continue
            raise _no_cluster(address, str(error).splitlines()[0]) from None
        return


def _knock(address: str) -> None:
    """Find out at once whether anybody listens; Ray itself would try for minutes."""
    try:
        place = urlsplit(address if "://" in address else f"//{address}")
        host, port = place.hostname, place.port
    except ValueError as error:
        raise _no_cluster(address, str(error)) from None
    if host is None or port is None:
        return  # 'auto' and its like: Ray knows
    try:
        socket.create_connection((host, port), timeout=_PROBE_S).close()
    except OSError as error:
        raise _no_cluster(address, error.strerror or str(error)) from None
    except ValueError:  # UnicodeError, of `a..b`
        raise _no_cluster(address, f"{host} cannot be a machine's name") from None


def _no_cluster(address: str, why: str) -> InputError:
    if _is_from_environment(address):
        return InputError(
            f"no Ray cluster answers at {_named(address)} ({why}); start one, or unset RAY_ADDRESS",
            code="cluster_missing",
        )
    return InputError(
        f"no Ray cluster answers at {address} ({why}); start one, or leave --address out", code="cluster_missing"
    )


def _named(address: str) -> str:
    """An address with where it comes from, where no option named it."""
    return f"{address} (RAY_ADDRESS)" if _is_from_environment(address) else address


def _is_from_environment(address: str) -> bool:
    return address == os.environ.get("RAY_ADDRESS")


def cluster_cpus() -> float:
    """CPUs that the connected cluster declares."""
    import ray

    resources: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]  # ray does not annotate it
    return resources.get("CPU", 1.0)


def has_workers() -> bool:
    """Whether any node of the connected cluster offers a CPU."""
    import ray

    resources: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]  # ray does not annotate it
    return resources.get("CPU", 0.0) >= 1.0


def _gpus() -> int:
    """GPUs that the connected cluster declares.

    Raises:
        InputError: none.
    """
    import ray

    resources: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]  # ray does not annotate it
    count = int(resources.get("GPU", 0.0))
    if not count:
        raise InputError("no GPU here for --solver cuda: use single or batch, or another --address", code="gpu_missing")
    return count


def is_ray_client() -> bool:
    """Whether this process reaches its cluster through Ray's client (``ray://``)."""
    from ray.util import client

    connected: bool = client.ray.is_connected()  # type: ignore[no-untyped-call]  # ray does not annotate it
    return connected
