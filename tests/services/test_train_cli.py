"""`drapemeter train`, from a store to a model."""

from __future__ import annotations

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from services.cli import main
from services.training.job import TrainingRank
from tests.services.analytic_store import QUICK, failure, run_json
from trainer.config import NetworkConfig
from trainer.model import load_model
from trainer.tracking import TensorBoardLog
from trainer.train import Progress


def test_train_prints_one_document(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = run_json(capsys, "train", "--store", str(store), "--out", str(tmp_path / "m"), *QUICK)
    assert set(document) == {"model", "model_version", "seconds", "config", "metrics"}
    assert document["config"]["network"]["trunk_width"] == 0.125 and document["config"]["epochs"] == 1
    assert document["metrics"]["materials"] == {"train": 11, "calibration": 3, "test": 2}
    meta = json.loads((tmp_path / "m" / "model.json").read_text())
    assert meta["model_version"] == document["model_version"]
    assert meta["provenance"]["data"]["configuration"] == {"made": "by hand"}
    assert meta["provenance"]["base_weights"] is None


def test_several_stores_are_learnt_from_together(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The other one holds the same fabrics, so that none is both learnt from and tested on."""
    other = shutil.copytree(store, tmp_path / "other.zarr")
    asked = ["train", "--store", str(store), "--store", str(other), "--out", str(tmp_path / "m"), *QUICK]
    document = run_json(capsys, *asked)
    assert document["metrics"]["materials"] == {"train": 11, "calibration": 3, "test": 2}
    meta = json.loads((tmp_path / "m" / "model.json").read_text())
    assert meta["provenance"]["data"]["configuration"]["merged"] == [{"made": "by hand"}] * 2


def test_a_model_that_its_disk_has_no_room_for_is_kept_elsewhere(
    model: Path, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write, spare = Path.write_bytes, tmp_path / "temporary"
    spare.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(spare))

    def full(path: Path, content: bytes) -> int:
        if not path.is_relative_to(spare):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    monkeypatch.setattr("services.cli.train.run", lambda *_: load_model(model))
    asked = ("train", "--store", str(store), "--out", str(tmp_path / "m"), *QUICK)
    status, said = failure(capsys, *asked)
    assert status == 1 and "cannot be written (No space left on device)" in said and not (tmp_path / "m").exists()
    assert said.endswith("[model_not_written]")
    kept = Path(said.split("the trained model is in ")[1].split(" [")[0])
    assert kept.parent == spare and load_model(kept).version == load_model(model).version
    spare = tmp_path / "nowhere"
    assert "is in" not in failure(capsys, *asked)[1] and sorted((tmp_path / "temporary").iterdir()) == [kept]


def test_the_model_is_safe_before_the_last_events(
    model: Path, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever becomes of them: hours of training are behind it."""

    def fails(*_: object) -> None:
        raise RuntimeError("the last events")

    monkeypatch.setattr("trainer.train.train", lambda *_, **__: load_model(model))
    monkeypatch.setattr("trainer.tracking.TensorBoardLog.finish", fails)
    out, events = tmp_path / "m", tmp_path / "events"
    code, said = failure(capsys, "train", "--store", str(store), "--out", str(out), "--tensorboard", str(events))
    assert code == 1 and "the last events" in said
    assert load_model(out).version == load_model(model).version


def test_an_interrupted_training_closes_its_events(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, report: Callable[[Progress], None], **__: object) -> None:
        report(Progress(1, 2, 0.5))
        raise KeyboardInterrupt

    closed: list[TensorBoardLog] = []
    monkeypatch.setattr("trainer.train.train", interrupted)
    monkeypatch.setattr(TensorBoardLog, "close", lambda log: closed.append(log))
    out, events = tmp_path / "m", tmp_path / "events"
    code, _ = failure(capsys, "train", "--store", str(store), "--out", str(out), "--tensorboard", str(events))
    assert code == 130 and len(closed) == 1 and not out.exists()


def test_bad_input_is_told_in_one_line(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, here = str(tmp_path / "new"), str(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    cases = [
        (["train", "--store", str(tmp_path / "no.zarr"), "--out", out], "no.zarr"),
        (["train", "--store", here, "--out", out, "--epochs", "0"], "epoch"),
        (["train", "--store", here, "--out", out, "--preset", "best"], "standard, paper, quick"),
        (["train", "--store", here, "--out", out, "--input-size", "100"], "input size 100"),
        (["train", "--store", here, "--out", here], "holds no model"),
        (["train", "--store", here, "--out", out, "--seed", "-1"], "negative"),
        (["train", "--store", here, "--out", out, "--pictures", "-5"], "negative"),
        (["train", "--store", here, "--out", out, "--address", "ray://nowhere:1"], "--ranks"),
        (["train", "--store", here, "--out", out, "--start", str(model), "--trunk-width", "1"], "leave out"),
        (["train", "--store", here, "--out", out, "--tensorboard", f"{out}/events"], "lies in"),
    ]
    for arguments, words in cases:
        code, said = failure(capsys, *arguments)
        assert code == 2 and words in said, (arguments, said)
    assert not Path(out).exists()


def test_a_training_that_cannot_begin_leaves_nothing(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments, words, code in (
        (["--store", "no.zarr"], "no.zarr", "store_missing"),
        (["--store", "a", "--store", "b", "--store", "a"], "a is named twice", "store_twice"),
        (["--store", str(store), "--store", f"{store}/"], "is named twice", "store_twice"),
        (["--store", str(store), "--ranks", "-1"], "-1 ranks: give at least 1", "ranks"),
    ):
        status, said = failure(capsys, "train", *arguments, "--out", "m", "--tensorboard", "events", *QUICK)
        assert status == 2 and words in said and said.endswith(f"[{code}]")
        assert not list(tmp_path.iterdir())


def test_a_place_that_no_model_can_take_is_refused_before_the_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A model takes its place by a rename in the folder around it."""
    out = tmp_path / "around" / "model"
    out.mkdir(parents=True)
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != out.parent)
    code, said = failure(capsys, "train", "--store", "s.zarr", "--out", str(out), *QUICK)
    assert code == 2 and f"{out.parent} cannot be written to: a model takes its place by a rename there" in said
    monkeypatch.setattr(Path, "is_mount", lambda path: path == out)
    code, said = failure(capsys, "train", "--store", "s.zarr", "--out", str(out), *QUICK)
    assert code == 2 and "is where a disk is mounted" in said and said.endswith("[output_exists]")


@pytest.mark.ray
@pytest.mark.slow
def test_two_ranks_on_ray_train_one_model(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = str(tmp_path / "m")
    monkeypatch.chdir(store.parent)  # workers are in another folder
    document = run_json(capsys, "train", "--store", store.name, "--out", out, *QUICK, "--ranks", "2")
    assert document["metrics"]["materials"]["test"] == 2
    code, said = failure(capsys, "train", "--store", str(store), "--out", out, *QUICK, "--ranks", "5")
    assert code == 2 and "5 loaders but only 4 shards" in said


def test_what_lies_beside_a_model_is_not_lost(
    model: Path, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, link = tmp_path / "m", tmp_path / "link"
    shutil.copytree(model, folder)
    link.symlink_to(folder)
    assert main.run(["train", "--store", str(store), "--out", str(link), *QUICK]) == 0
    assert link.is_symlink() and (folder / "model.json").is_file()
    (folder / "notes.txt").write_text("mine")
    code, said = failure(capsys, "train", "--store", str(store), "--out", str(folder), *QUICK)
    assert code == 2 and "notes.txt" in said and (folder / "notes.txt").read_text() == "mine"


def test_ranks_go_on_from_the_model_they_are_given(store: Path, model: Path) -> None:
    start = load_model(model)
    config = replace(start.config, network=NetworkConfig(trunk_width=0.25), epochs=1)
    made = TrainingRank([str(store)], config, start, 0, 1).run("")
    assert made is not None and made.config.network == start.config.network
    assert made.provenance["start"]["model_version"] == start.version


def test_a_picture_that_is_lost_is_not_learnt_from(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "cut.zarr"
    shutil.copytree(store, copy)
    (copy / "depth" / "c" / "1" / "0" / "0").unlink()
    code, said = failure(capsys, "train", "--store", str(copy), "--out", str(tmp_path / "m"), *QUICK)
    assert code == 1 and "has no picture" in said and not (tmp_path / "m").exists()
