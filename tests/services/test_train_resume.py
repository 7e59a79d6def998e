"""`drapemeter train --resume`: an interrupted training is told of, gone on with, and its checkpoint taken away."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from services.cli import main
from tests.services.analytic_store import QUICK, failure, run_json
from trainer import checkpoint
from trainer.train import Progress

LONGER = [*QUICK, "--epochs", "3"]
"""Three steps."""


class Interrupted(NamedTuple):
    """Where the model would have been, and what was said on standard error."""

    out: Path
    said: str


@pytest.fixture
def interrupted(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Interrupted:
    """A training of which two steps were done."""

    def show_on(bar: object) -> Callable[[Progress], None]:
        def show(progress: Progress) -> None:
            if progress.step == 2:
                raise KeyboardInterrupt

        return show

    monkeypatch.setattr(checkpoint, "STEPS_BETWEEN", 2)
    with monkeypatch.context() as patched:
        patched.setattr("services.cli.train.show_on", show_on)
        assert main.run(["train", "--store", str(store), "--out", str(tmp_path / "m"), *LONGER]) == 130
    return Interrupted(tmp_path / "m", capsys.readouterr().err)


def test_a_resumed_training_makes_the_model_and_leaves_it_alone(
    store: Path, interrupted: Interrupted, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert interrupted.said.splitlines() == [
        f"{interrupted.out}.checkpoint: kept behind step 2; --resume goes on from there",
        "error: interrupted [interrupted]",
    ]
    command = ("train", "--store", str(store), "--out")
    whole = run_json(capsys, *command, str(tmp_path / "whole"), *LONGER)
    resumed = run_json(capsys, *command, str(interrupted.out), *LONGER, "--resume")
    assert resumed["model_version"] == whole["model_version"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m", "whole"]
    code, said = failure(capsys, *command, str(interrupted.out), *LONGER, "--resume")
    assert code == 2 and said.endswith("[checkpoint_missing]")


def test_what_is_asked_otherwise_leaves_the_checkpoint(
    store: Path, interrupted: Interrupted, capsys: pytest.CaptureFixture[str]
) -> None:
    place = interrupted.out.with_name("m.checkpoint")
    before = place.read_bytes()
    for options, words, code in (
        ([], "give --resume to go on with it", "training_unfinished"),
        (["--ranks", "2"], "give --resume to go on with it", "training_unfinished"),
        (["--resume", "--ranks", "2"], "--resume is for a training in one process", "options_exclude"),
        (["--resume", "--epochs", "4"], "epochs (then 3, now 4)", "checkpoint_of_another_run"),
    ):
        status, said = failure(capsys, "train", "--store", str(store), "--out", str(interrupted.out), *LONGER, *options)
        assert status == 2 and words in said and said.endswith(f"[{code}]"), said
    assert place.read_bytes() == before and not interrupted.out.exists()


def test_a_failure_behind_the_model_tells_of_no_checkpoint(
    store: Path, interrupted: Interrupted, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object) -> None:
        raise RuntimeError("behind the model")

    monkeypatch.setattr("services.cli.train.report", fails)
    assert main.run(["train", "--store", str(store), "--out", str(interrupted.out), *LONGER, "--resume"]) == 1
    said = capsys.readouterr().err
    assert "behind the model" in said and "--resume goes on from there" not in said
    assert [path.name for path in interrupted.out.parent.iterdir()] == ["m"]
