"""Whether worker processes end with the process that started them, however that ends."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

HEAD = """
import signal, sys
sys.path.insert(0, {root!r})
from tests.left_workers import wait_long
"""
"""What a holder's program begins with; ``{places!r}`` in the rest are the two items to work on."""


def wait_long(place: str) -> str:
    """An item of work that says where it is and takes five minutes."""
    Path(place).touch()
    time.sleep(300.0)
    return place


def check_workers_end(folder: Path, program: str, how: signal.Signals) -> None:
    """Run a program whose two workers are busy for long, end it by a signal, and see that both are gone.

    Args:
        folder: for the program and what its workers touch.
        program: without :data:`HEAD`.
        how: the signal.
    """
    script, at_work = folder / "holder.py", [folder / "one", folder / "two"]
    root, places = str(Path(__file__).parents[1]), [str(place) for place in at_work]
    script.write_text((HEAD + program).format(root=root, places=places))
    holder = subprocess.Popen([sys.executable, str(script)], stderr=subprocess.DEVNULL)
    wait_until(lambda: all(place.exists() for place in at_work))
    workers = spawned_by(holder.pid)
    assert len(workers) == 2
    holder.send_signal(how)
    holder.wait(60)
    wait_until(lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers))


def spawned_by(parent: int) -> list[int]:
    """Worker processes of a process; its resource tracker is none."""
    text = Path(f"/proc/{parent}/task/{parent}/children").read_text()
    return [int(pid) for pid in text.split() if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def wait_until(done: Callable[[], bool]) -> None:
    """A minute at most."""
    end = time.monotonic() + 60.0
    while not done():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.1)
