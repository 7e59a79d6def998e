"""The one place that imports Taichi.

One runtime a process, float64, started on first use. Kernels elsewhere say ``from simcore.lang import ti`` and call
:func:`start` before their first launch. Each process gets an offline cache folder of its own: processes that run side
by side corrupt a shared one.
"""

from __future__ import annotations

import contextlib
import io
import os
import stat
import tempfile
from pathlib import Path
from typing import Any

from simcore.errors import MissingResourceError
from simcore.kernel_positions import tell_positions_short

os.environ.setdefault("TI_LOG_LEVEL", "error")
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

import taichi as ti

__all__ = ["on_cpu", "start", "ti"]

_started: str | None = None


def start(arch: str | None = None) -> Any:
    """Start the runtime of this process once; later calls with the same ``arch`` do nothing.

    Args:
        arch: ``cpu`` (one thread: a worker owns a core), ``cuda``, or None for the one that runs, else ``cpu``.

    Raises:
        RuntimeError: started before with another ``arch``.
    """
    global _started
    arch = arch or _started or "cpu"
    if _started is None:
        with contextlib.redirect_stdout(io.StringIO()):  # it greets on standard output, which belongs to results
            _initialise(arch)
        _started = arch
    elif _started != arch:
        raise RuntimeError(f"Taichi runs on {_started} in this process; start another process for {arch}")
    return ti


def on_cpu() -> bool:
    """The runtime of this process runs on the CPU.

    Kernels' loops are serial there: Taichi hands others to a thread of its own and wakes it for each of them, which on
    a two-core cloud machine costs 0.1 ms, more than an energy on a 26 x 26 grid.
    """
    return _started == "cpu"


def _initialise(arch: str) -> None:
    tell_positions_short()
    ti.init(
        arch=ti.cuda if arch == "cuda" else ti.cpu,
        default_fp=ti.f64,
        default_ip=ti.i32,
        cpu_max_num_threads=1,
        offline_cache=True,
        offline_cache_file_path=str(_cache_folder()),
        log_level=ti.ERROR,
    )


def _cache_folder() -> Path:
    """Cache of compiled kernels that no other live process holds: under ``DRAPEMETER_KERNEL_CACHE`` where that is set,
    else under this user's caches."""
    named = os.environ.get("DRAPEMETER_KERNEL_CACHE")
    if named:
        return _claim(Path(named))
    base = os.environ.get("XDG_CACHE_HOME")
    if base:
        return _claim(Path(base) / "drapemeter" / "kernels")
    return _claim(_own_folder(Path(tempfile.gettempdir()) / f"drapemeter-{os.getuid()}") / "kernels")


def _own_folder(folder: Path) -> Path:
    """A folder in a place that others may write to, too; a new one where somebody else has made one of that name.

    What lies in it is compiled code that is run.
    """
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid():
        folder.chmod(0o700)
        return folder
    return Path(tempfile.mkdtemp(prefix=f"{folder.name}-", dir=folder.parent))


_claims: list[Any] = []


def _claim(root: Path) -> Path:
    """First numbered folder under ``root`` whose lock is free; the lock is held until the process ends."""
    import fcntl

    for number in range(256):
        folder = root / str(number)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            handle = (folder / "lock").open("w")
        except PermissionError:  # another user's, of a cache that several share
            continue
        except OSError as error:
            raise MissingResourceError(
                f"{root}: no folder for compiled kernels can be there ({error.strerror}): set DRAPEMETER_KERNEL_CACHE "
                "to a folder of your own",
                code="kernel_cache",
            ) from None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            handle.close()
            continue
        _claims.append(handle)
        return folder / "cache"
    raise MissingResourceError(
        f"all 256 folders for compiled kernels under {root} are in use or another user's: set DRAPEMETER_KERNEL_CACHE "
        "to a folder of your own",
        code="kernel_cache",
    )
