"""Cores that may be used: those the process may be put on, and no more than a container's quota fills."""

from __future__ import annotations

from pathlib import Path

import pytest

from simcore import cores
from simcore.cores import usable_cores

QUOTA, PERIOD = "cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us"


@pytest.mark.parametrize(
    ("files", "count"),
    [
        ({}, 8),
        ({"cpu.max": "200000 100000\n"}, 2),
        ({"cpu.max": "250000 100000\n"}, 3),
        ({"cpu.max": "5000 100000\n"}, 1),
        ({"cpu.max": "6400000 100000\n"}, 8),
        ({"cpu.max": "max 100000\n"}, 8),
        ({QUOTA: "150000\n", PERIOD: "100000\n"}, 2),
        ({QUOTA: "-1\n", PERIOD: "100000\n"}, 8),
        ({QUOTA: "200000\n"}, 8),
        ({"cpu.max": ""}, 8),
        ({"cpu.max": "200000\n"}, 8),
        ({"cpu.max": "200000 0\n"}, 8),
        ({"cpu.max": "-200000 100000\n"}, 8),
        ({"cpu.max": "zwei höchstens\n"}, 8),
        ({"cpu.max/a-folder": ""}, 8),
    ],
)
def test_a_containers_quota_is_heeded(
    files: dict[str, str], count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cores, "CGROUPS", tmp_path)
    monkeypatch.setattr("os.sched_getaffinity", lambda process: set(range(8)))
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert usable_cores() == count
