"""What an option says arrives at what does the work, and so does what holds where it is left away."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from services.cli import main
from services.version import software_version
from tests.services.command_inputs import make_inputs

Call = dict[int | str, Any]
"""What something was called with, by number and by name."""
IMPORT = "capture import frames --camera camera.json --fabric a --scene hanging --out new"
CASES: list[tuple[str, str, Callable[[Call], object], dict[str, object]]] = [
    (
        "blind score check",
        "diagnosis.blind.answers.answer_cases",
        lambda call: call["seconds"],
        {"": math.inf, "--minutes 0": math.inf, "--minutes 1.5": 90.0},
    ),
    (
        IMPORT,
        "capture.record.record_capture",
        lambda call: call[2].setup,
        {"": {}, "--panel": {"panel": True}, "--no-panel": {"panel": False}},
    ),
    (IMPORT, "capture.record.record_capture", lambda call: call["frames"], {"": 30, "--frames 7": 7}),
    (
        "capture record --fabric a --scene hanging --out new",
        "capture.realsense.RealSenseSource",
        lambda call: call["serial"],
        {"": None, "--serial 0815": "0815"},
    ),
    (
        "dataset --materials 3 --out new.zarr",
        "services.dataset.sweep.run_sweep",
        lambda call: call["recycle_after"],
        {"": 2000, "--recycle 5": 5},
    ),
    (
        "dataset export s.zarr --out new",
        "services.dataset.export.export_store",
        lambda call: call["shaded"],
        {"": False, "--shaded": True},
    ),
    (
        "diagnose set --out new",
        "diagnosis.diagnose.diagnose",
        lambda call: call[1].without,
        {"": (), "--without crease,hem_weight": ("crease", "hem_weight")},
    ),
    (
        "rank p.json library.json --backend depth",
        "metric.search.search_library",
        lambda call: call["exact"],
        {"": None, "--exact": True, "--sketch": False},
    ),
    (
        "train --store s.zarr --out new",
        "services.cli.train.run",
        lambda call: call[1].pretrained,
        {"": False, "--preset paper": True, "--preset paper --scratch": False, "--pretrained": True},
    ),
    (
        "train --store s.zarr --out new",
        "services.cli.train.run",
        lambda call: call[1].threads,
        {"": 1, "--threads 3": 3},
    ),
]


@pytest.mark.parametrize(
    ("command", "work", "seen", "option", "expected"),
    [
        pytest.param(command, work, seen, option, expected, id=f"{command.split(' --')[0]} {option}".strip())
        for command, work, seen, options in CASES
        for option, expected in options.items()
    ],
)
def test_an_option_arrives(
    command: str,
    work: str,
    seen: Callable[[Call], object],
    option: str,
    expected: object,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[Call] = []

    def begun(*given: object, **named: object) -> None:
        calls.append(dict([*enumerate(given), *named.items()]))
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DRAPEMETER_CACHE", str(tmp_path / "cache"))
    make_inputs(tmp_path)
    monkeypatch.setattr("renderer.store.Store.open", lambda url: SimpleNamespace(shards=1))
    monkeypatch.setattr(work, begun)
    assert main.run([*command.split(), *option.split()]) == main.EXIT_INTERRUPTED
    (call,) = calls
    assert seen(call) == expected


def test_the_version_is_that_of_the_distribution(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["--version"]) == 0
    assert capsys.readouterr().out == f"drapemeter {software_version()}\n"
