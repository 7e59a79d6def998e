"""The side programs `python -m trainer...` find out what cannot be before they train for hours."""

from __future__ import annotations

import errno
import json
import os
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import pytest

from simcore.errors import InputError
from tests.services.dataset_helpers import small_sweep
from tests.services.dataset_rows import made_up_store
from trainer import ablation, program
from trainer.config import TrainConfig
from trainer.dataset import PictureTable
from trainer.model import TrainedModel


def test_an_ablation_needs_both_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = made_up_store(tmp_path / "h.zarr", *small_sweep(materials=3, scenes=("hanging",)))
    monkeypatch.setattr(ablation, "run", lambda *given: pytest.fail("it began to train"))
    options = Namespace(store=str(store), out=tmp_path / "out", preset="quick", epochs=1, seed=0, pretrained=False)
    with pytest.raises(InputError, match="lacks usable pictures of stretch: the ablation compares both") as caught:
        ablation._run(options)
    assert caught.value.code == "scene_missing"
    assert not (tmp_path / "out").exists()


def test_a_file_in_the_place_of_results_is_told_beforehand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(SystemExit) as ended, program.told_in_one_line():
        program.make_results_folder(tmp_path / "out")
    assert ended.value.code == 2
    assert capsys.readouterr().err.strip().endswith("[folder_unusable]")
    assert (tmp_path / "out").read_text() == "mine"


def test_a_folder_that_nobody_may_write_to_is_told_beforehand() -> None:
    with pytest.raises(InputError, match=r"^/proc/self: cannot be written to \(.*\); name another$") as caught:
        program.make_results_folder(Path("/proc/self"))
    assert caught.value.code == "folder_unusable"


def test_an_ablation_of_fabrics_that_were_not_tested_on_both_scenes_has_dashes(
    tiny_model: TrainedModel, tmp_path: Path
) -> None:
    """After all its training."""
    scores = {name: score for name, score in tiny_model.metrics.scores.items() if name != "hanging+stretch"}
    tested = replace(tiny_model.metrics, scores=scores)
    ablation.write(tmp_path, {"baseline": tested, "more": tiny_model.metrics}, {"depth": tested})
    text = (tmp_path / "ablation.md").read_text()
    assert "| baseline | - | - | - | - | - | - |\n" in text and "nan" not in text
    assert list(json.loads((tmp_path / "ablation.json").read_text())) == ["baseline", "more", "depth"]


def test_an_ablation_that_stops_keeps_what_was_trained(
    tiny_model: TrainedModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each configuration takes as long as a training."""
    store = made_up_store(tmp_path / "s.zarr", *small_sweep(materials=3))
    begun: list[bool] = []

    def trained(source: object, config: TrainConfig) -> TrainedModel:
        begun.append(config.pretrained)
        if len(begun) == 3:
            raise KeyboardInterrupt
        return tiny_model

    monkeypatch.setattr(ablation, "train", trained)
    monkeypatch.setattr(ablation, "as_long", lambda config, pictures: config)
    monkeypatch.setattr(ablation, "split_of", lambda pictures, config: None)
    monkeypatch.setattr(ablation, "evaluate", lambda *given: tiny_model.metrics)
    monkeypatch.setattr(PictureTable, "upright", lambda table: table)
    options = Namespace(store=str(store), out=tmp_path / "out", preset="paper", epochs=1, seed=0, pretrained=False)
    with pytest.raises(KeyboardInterrupt):
        ablation._run(options)
    assert (
        list(json.loads((tmp_path / "out" / "ablation.json").read_text()))
        == list(ablation.ladder(TrainConfig(), pretrained=False))[:2]
    )
    assert (tmp_path / "out" / "ablation.md").read_text().count("\n| ") == 3


def test_inputs_are_compared_without_weights_that_were_not_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = made_up_store(tmp_path / "s.zarr", *small_sweep(materials=3))
    wanted: list[bool] = []
    monkeypatch.setattr(
        ablation, "run", lambda sources, configs, keep: wanted.extend(c.pretrained for c in configs.values()) or {}
    )
    for pretrained in (False, True):
        monkeypatch.setattr(ablation, "find_pretrained", lambda: wanted.append(True))
        wanted.clear()
        options = Namespace(
            store=str(store), out=tmp_path / "out", preset="paper", epochs=1, seed=0, pretrained=pretrained
        )
        ablation._run(options)
        assert any(wanted) is pretrained


def test_a_full_disk_is_told_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, program.told_in_one_line():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "out/saliency.npz")
    assert ended.value.code == 1
    said = capsys.readouterr().err
    assert said.startswith("error: out/saliency.npz: ") and said.endswith("[cannot_write]\n") and said.count("\n") == 1


def test_another_failure_of_reading_is_not_taken_for_a_full_disk() -> None:
    with pytest.raises(FileNotFoundError), program.told_in_one_line():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), "captures.json")
