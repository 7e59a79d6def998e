"""`drapemeter dataset` from the outside: exit codes, one clear line, one JSON document."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from renderer.store import RowStatus, Store
from services.cli.dataset_run import Watch
from services.cli.main import run
from services.console import ProgressBar
from services.dataset.cost import CostEstimate
from services.dataset.worker import SimulationDone
from tests.services.dataset_helpers import small_sweep
from tests.services.dataset_rows import made_up_store

BASE = ["dataset", "--materials", "10", "--jitters", "1", "--inclinations", "2", "--resolution", "0.05", "--seed", "4"]
SMALL = [*BASE, "--shard-simulations", "3"]


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """A complete store of the small sweep."""
    return made_up_store(tmp_path / "s.zarr", *small_sweep())


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--scenes", "hanging,lying"], "scene_unknown"),
        (["--range", "density=0.3:0.1"], "range_order"),
        (["--range", "density"], "range_form"),
        (["--range", "weight=1:2"], "range_unknown"),
        (["--sensor", "eye"], "sensor_unknown"),
        (["--design", "cube"], "design_unknown"),
        (["--fabrics", "nowhere.csv"], "file_missing"),
        (["--resolution", "0.03"], "resolution_does_not_divide"),
        (["--address", "127.0.0.1:9"], "cluster_missing"),
        (["--time-limit", "-1"], "sweep_value"),
    ],
)
def test_bad_input_is_one_line_exit_2_and_nothing_written(
    arguments: list[str], code: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([*SMALL, "--out", str(tmp_path / "new.zarr"), *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].endswith(f"[{code}]")
    assert list(tmp_path.iterdir()) == []


def test_options_before_a_subcommand_are_not_passed_over(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for option in (["--json"], ["--materials", "3"]):
        assert run(["dataset", *option, "inspect", str(store)]) == 2
        caught = capsys.readouterr()
        assert f"{option[0]} stands before inspect" in caught.err and caught.out == ""
    assert run(["dataset", "inspect", str(store), "--json"]) == 0


def test_missing_out_and_materials_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, said in (
        (["--materials", "3"], "error: say where the store shall be: --out store.zarr [out_missing]"),
        (["--out", "x.zarr"], "error: say how many fabrics: --materials N [materials_missing]"),
        (["--out", "x.zarr", "--design", "list"], "needs the file of fabrics: --fabrics FILE [list_missing]"),
    ):
        assert run(["dataset", *arguments]) == 2
        assert capsys.readouterr().err.strip().endswith(said)
    assert not Path("x.zarr").exists()


def test_a_store_that_is_there_is_left_as_it_is(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = Store.open(store).checksums
    assert run([*SMALL, "--out", str(store)]) == 2
    assert "--resume" in capsys.readouterr().err
    assert run([*SMALL, "--out", str(store), "--resume", "--seed", "5", "--time-limit", "7"]) == 2
    said = capsys.readouterr().err
    assert "other settings (seed, time_limit_s); resume it with its own" in said
    assert said.endswith("[store_configuration]\n")
    assert (Store.open(store).checksums == before).all()


def test_resuming_a_complete_store_does_nothing(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*SMALL, "--out", str(store), "--resume", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert set(summary) == {"samples", "failed", "seconds"}
    assert (summary["samples"], summary["failed"]) == (40, {"timed_out": 2})


def test_cost_is_told_before_anything_starts(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["dataset", "--materials", "1000", "--dry-run", "--workers", "8", "--json"]) == 0
    cost = json.loads(capsys.readouterr().out)
    assert (cost["simulations"], cost["pictures"], cost["workers"]) == (4000, 44000, 8)
    assert cost["core_hours"] > cost["hours"] > 0 and cost["gigabytes"] > 0


def test_cost_is_that_on_the_cores_that_may_be_used(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("simcore.cores.usable_cores", lambda: 3)
    assert run(["dataset", "--materials", "1000", "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["workers"] == 3


def test_inspect_validate_merge_and_export(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["dataset", "inspect", str(store), "--figures", str(tmp_path / "figures"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["failed"] == {"timed_out": 2}
    assert run(["dataset", "validate", str(store), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["valid"] is True
    assert run(["dataset", "merge", str(store), str(store), "--out", str(tmp_path / "two.zarr"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["samples"] == 80
    assert run(["dataset", "export", str(store), "--out", str(tmp_path / "png"), "--limit", "3", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["samples"] == 3


def test_a_damaged_store_is_exit_1_and_a_missing_one_exit_2(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (store / "status" / "c" / "0").unlink()
    assert run(["dataset", "validate", str(store)]) == 1
    assert "shard 0: status/c/0 is missing" in capsys.readouterr().out
    assert run(["dataset", "inspect", str(store) + ".not"]) == 2


def test_a_place_without_permission_is_exit_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder below a file cannot be made by anyone, root included."""
    (tmp_path / "file").write_text("")
    assert run([*SMALL, "--out", "/proc/drapes.zarr"]) == 2
    assert run([*SMALL, "--out", str(tmp_path / "file" / "s.zarr")]) == 2
    assert run([*SMALL, "--out", str(tmp_path / "file")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) >= 3


def test_a_log_gets_a_line_now_and_then(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.cli.dataset_run.NOTE_S", 0.0)
    watch = Watch(ProgressBar())
    watch.begin(CostEstimate(4, 8, 0.1, 0.05, 0.001, 2))
    for number, status in enumerate([RowStatus.OK, RowStatus.TIMED_OUT]):
        watch.hear(SimulationDone(number, status, number, "here", 1, 1, False))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("4 simulations, 8 pictures: about 0.1 core hours")
    assert lines[-1] == "2 of 4 simulations, 1 failed, 0 min to go"
