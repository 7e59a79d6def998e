"""How the process of a command ends where Ray was used in it."""

from __future__ import annotations

import atexit
import os
import sys
from dataclasses import dataclass


@dataclass
class Ending:
    """What the process is to end with.

    Native threads of Ray outlive ``ray.shutdown``, and now and then take the interpreter down while it is torn down,
    when all is done and told: a command that went well ended by a segmentation fault. Such a process is left at once
    when Python's own handlers have run and all output is out.

    Attributes:
        status: exit code; None while the command runs.
    """

    status: int | None = None

    @classmethod
    def prepared(cls) -> Ending:
        """To be asked for before anything registers handlers: they run in reverse, so that this one is the last."""
        ending = cls()
        atexit.register(ending.leave)
        return ending

    def leave(self) -> None:
        """End now where Ray was used and the command came to an end; else Python goes on with its own."""
        if self.status is None or "ray" not in sys.modules or hasattr(sys, "last_type"):
            return  # an error that nothing caught: Python's own status tells of it
        for stream in (sys.stdout, sys.stderr):
            try:
                if stream is not None:
                    stream.flush()
            except (OSError, ValueError):  # Python tells of it when it tries in its turn
                return
        os._exit(self.status)
