"""How many cores a process may use."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path

CGROUPS = Path("/sys/fs/cgroup")
_QUOTAS = (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us"))
"""Files that hold a container's quota of CPU time and its period, of control groups' version 2 and of version 1."""


def usable_cores() -> int:
    """Cores this process may be put on, or fewer where its container has a quota of CPU time; at least one."""
    return math.ceil(min(len(os.sched_getaffinity(0)), _quota()))


def _quota() -> float:
    """CPU seconds a second that the container may use; infinite where no limit is set, or none that can be read."""
    for names in _QUOTAS:
        with suppress(OSError, ValueError):  # no such file, `max` in place of a number, or an odd one
            stated = " ".join((CGROUPS / name).read_text(encoding="ascii") for name in names)
            quota, period = map(int, stated.split())
            if quota > 0 and period > 0:
                return quota / period
    return math.inf
