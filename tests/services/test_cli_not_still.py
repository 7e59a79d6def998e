"""`drapemeter simulate` without a drape at rest: exit 1 with a reason, the best so far written, no set made."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from renderer.depth_png import read_depth_png
from renderer.ply import read_ply
from services.cli import main
from simcore.drape import Drape, DrapeStatus
from simcore.solver import Solver
from tests.services.test_cli_simulate import command, parameters

__all__ = ["parameters"]


def told(capsys: pytest.CaptureFixture[str], status: str, reason: str) -> dict[str, Any]:
    """The JSON document, which states the status and its reason as the one line of the error does."""
    captured = capsys.readouterr()
    document: dict[str, Any] = json.loads(captured.out)
    assert document["status"] == status and reason in document["reason"]
    assert captured.err == f"error: the drape is {status}: {document['reason']} [drape_not_still]\n"
    return document


def ending_as(monkeypatch: pytest.MonkeyPatch, **changes: Any) -> None:
    """Let every drape end with these fields."""
    solve = Solver.solve

    def ended(*arguments: Any, **options: Any) -> Drape:
        drape = solve(*arguments, **options)
        if changes["status"] is DrapeStatus.DIVERGED:
            return replace(drape, vertices=np.full_like(drape.vertices, np.nan), **changes)
        return replace(drape, **changes)

    monkeypatch.setattr(Solver, "solve", ended)


def test_without_time_the_best_so_far_is_written_and_no_set_is_made(
    parameters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, depth, folder = tmp_path / "a.ply", tmp_path / "d.png", tmp_path / "set"
    more = ["--time-limit", "0", "--json", "--depth", str(depth), "--capture-set", str(folder)]
    assert main.run(command(parameters, out, *more)) == 1
    document = told(capsys, "not_still", "time limit")
    assert document["residual"] > 1e-3
    assert read_ply(out).vertices.shape == (441, 3) and read_depth_png(depth).max() > 0.0
    assert {path.name for path in tmp_path.iterdir()} == {"p.json", "a.ply", "d.png"}


def test_a_set_that_is_there_takes_no_drape_that_is_not_still(
    parameters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "set"
    arguments = command(parameters, tmp_path / "a.ply", "--capture-set", str(folder))
    assert main.run(arguments) == 0
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    capsys.readouterr()
    assert main.run([*arguments, "--seed", "1", "--time-limit", "0", "--json"]) == 1
    told(capsys, "not_still", "time limit")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_drape_that_its_mesh_does_not_resolve_is_written_and_no_set_is_made(
    parameters: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ending_as(monkeypatch, status=DrapeStatus.UNDER_RESOLVED, reason="12 % of the sample folds")
    out = tmp_path / "a.ply"
    assert main.run(command(parameters, out, "--json", "--capture-set", str(tmp_path / "set"))) == 1
    told(capsys, "under_resolved", "12 % of the sample folds")
    assert read_ply(out).vertices.shape == (441, 3)
    assert {path.name for path in tmp_path.iterdir()} == {"p.json", "a.ply"}


def test_of_a_diverged_drape_nothing_is_written(
    parameters: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ending_as(monkeypatch, status=DrapeStatus.DIVERGED, reason="positions are not finite", residual=np.inf)
    files = ["--depth", str(tmp_path / "d.png"), "--capture-set", str(tmp_path / "set")]
    assert main.run(command(parameters, tmp_path / "a.ply", "--json", *files)) == 1
    told(capsys, "diverged", "not finite")
    assert main.run(command(parameters, tmp_path / "a.ply", *files)) == 1
    captured = capsys.readouterr()
    assert captured.out.startswith("diverged: ") and "->" not in captured.out
    assert captured.err.endswith("[drape_not_still]\n")
    assert [path.name for path in tmp_path.iterdir()] == ["p.json"]


@pytest.mark.parametrize("place", ["__init__", "solve"])
@pytest.mark.parametrize(("given", "said"), [("Unable to allocate 2.0 GiB", "2.0 GiB"), ("", "no more")])
def test_too_little_memory_is_told_with_what_helps(
    parameters: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    place: str,
    given: str,
    said: str,
) -> None:
    def short_of_memory(*_: Any, **__: Any) -> None:
        raise MemoryError(given)

    monkeypatch.setattr(Solver, place, short_of_memory)
    assert main.run(command(parameters, tmp_path / "a.ply", "--json")) == 1
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert said in captured.err and "coarser cells" in captured.err and captured.err.endswith("[out_of_memory]\n")
    assert [path.name for path in tmp_path.iterdir()] == ["p.json"]
