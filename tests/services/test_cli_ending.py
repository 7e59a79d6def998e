"""How a command's process ends, with what crashes while the interpreter is torn down."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import atexit, os, sys, types
from services.cli import main

class Crash:
    def __del__(self, abort=os.abort):
        abort()

def command(arguments):
    if "ray" in arguments:
        sys.modules["ray"] = types.ModuleType("ray")
    atexit.register(print, "a handler of the command's")
    sys.crash = Crash()
    print("done", end=" ")
    return int(arguments[-1])

main.run = command
main.main()
"""


def ended(*arguments: str, stdout: int = subprocess.PIPE) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments], stdout=stdout, text=True, timeout=60, check=False
    )


@pytest.mark.parametrize("status", [0, 3])
def test_what_crashes_at_the_very_end_changes_nothing_where_ray_was_used(status: int) -> None:
    """The status is the command's, its output is out and its handlers have run."""
    process = ended("ray", str(status))
    assert process.returncode == status
    assert process.stdout == "done a handler of the command's\n"


def test_without_ray_python_ends_as_it_does() -> None:
    """Which shows that what is there to crash does."""
    assert ended("0").returncode == -signal.SIGABRT


def test_output_that_cannot_be_written_is_still_a_failure() -> None:
    with Path("/dev/full").open("w") as full:
        assert ended("ray", "0", stdout=full.fileno()).returncode != 0
