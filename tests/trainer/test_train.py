"""Training on analytic cloth: it learns, it repeats, it is stored whole."""

from __future__ import annotations

import errno
import json
import math
import os
import pickle
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

import trainer.train
from simcore.errors import DrapemeterError, InputError, StoreError
from simcore.parameters import ESTIMATED_NAMES
from trainer.config import NetworkConfig, TrainConfig
from trainer.dataset import Partition
from trainer.evaluate import Metrics
from trainer.inference import extract_pairs
from trainer.model import TrainedModel, load_model, model_version
from trainer.presets import PRESETS, preset_config
from trainer.train import Progress, mirror_hanging, split_of, train

from .analytic import AnalyticSource

SHORT = AnalyticSource(materials=12, jitters=1)


def test_it_beats_predicting_the_mean_on_held_out_materials(tiny_model: TrainedModel) -> None:
    metrics = tiny_model.metrics
    for scenes in ("hanging", "stretch", "hanging+stretch"):
        assert metrics.average(scenes, "mae_log", "bending") < 0.85 * metrics.average("mean", "mae_log", "bending")
        assert metrics.average(scenes, "spearman", "bending") > 0.45
    assert metrics.average("hanging+stretch", "mae_log") < metrics.average("density", "mae_log")
    assert metrics.materials == {"train": 36, "calibration": 12, "test": 12}


def test_intervals_cover_held_out_materials(tiny_model: TrainedModel) -> None:
    assert tiny_model.metrics.average("hanging+stretch", "coverage") > 0.75  # 12 materials: 0.9 +- 0.09


def test_the_same_run_gives_the_same_model(tiny_config: TrainConfig) -> None:
    config = replace(tiny_config, epochs=1)
    first, second = train(SHORT, config), train(SHORT, config)
    assert first.version == second.version
    assert train(SHORT, replace(config, seed=1)).version != first.version


def test_progress_is_reported(tiny_config: TrainConfig) -> None:
    seen: list[Progress] = []
    train(SHORT, replace(tiny_config, epochs=2, batch_size=4), report=seen.append)
    assert [p.step for p in seen] == list(range(1, len(seen) + 1))
    assert {p.steps for p in seen} == {len(seen)} and all(math.isfinite(p.loss) for p in seen)


def test_a_stored_model_is_the_same_to_the_bit(
    tiny_model: TrainedModel, analytic_source: AnalyticSource, tmp_path: Path
) -> None:
    version = tiny_model.save(tmp_path / "model")
    loaded = load_model(tmp_path / "model")
    assert version == tiny_model.version == loaded.version
    table = analytic_source.table().of_materials(torch.arange(3).numpy())
    before = extract_pairs(tiny_model.network, analytic_source, table)
    after = extract_pairs(loaded.network, analytic_source, table)
    assert torch.equal(before.maximum, after.maximum) and torch.equal(before.mean, after.mean)
    assert loaded.config == tiny_model.config and loaded.scaling == tiny_model.scaling
    assert loaded.intervals == tiny_model.intervals
    for scene, model in tiny_model.outliers.items():
        features, statistics = after.of_scene(0)
        assert (model.scores(features, statistics) == loaded.outliers[scene].scores(features, statistics)).all()


def test_a_model_of_an_earlier_program_keeps_its_version(tiny_model: TrainedModel, tmp_path: Path) -> None:
    """What was added to a model's description since then is filled in, and would make another hash."""
    tiny_model.save(tmp_path / "model")
    described = tmp_path / "model" / "model.json"
    meta = json.loads(described.read_text())
    del meta["model_version"], meta["config"]["mirror"]
    earlier = model_version((tmp_path / "model" / "weights.safetensors").read_bytes(), meta)
    described.write_text(json.dumps({**meta, "model_version": earlier}))
    loaded = load_model(tmp_path / "model")
    assert loaded.version == pickle.loads(pickle.dumps(loaded)).version == earlier != tiny_model.version
    assert loaded.save(tmp_path / "again") == load_model(tmp_path / "again").version == tiny_model.version
    assert replace(loaded, provenance={}).version not in {earlier, tiny_model.version}


def test_metrics_survive_json(tiny_model: TrainedModel) -> None:
    metrics = tiny_model.metrics
    again = Metrics.from_json(json.loads(json.dumps(metrics.to_json())))
    assert again.to_json() == metrics.to_json()
    assert all(name in metrics.table() for name in ESTIMATED_NAMES)


def test_saving_replaces_models_and_nothing_else(tiny_model: TrainedModel, tmp_path: Path) -> None:
    folder = tmp_path / "model"
    tiny_model.save(folder)
    assert tiny_model.save(folder) == tiny_model.version
    assert sorted(p.name for p in tmp_path.iterdir()) == ["model"]
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "chapter.txt").write_text("precious")
    with pytest.raises(InputError, match="holds no model: give another folder") as caught:
        tiny_model.save(other)
    assert caught.value.code == "output_exists"
    with pytest.raises(InputError, match=r"cannot be written .*; name another folder$") as caught:
        tiny_model.save(other / "chapter.txt" / "model")
    assert caught.value.code == "output_not_writable"
    assert [path.name for path in other.iterdir()] == ["chapter.txt"]
    assert (other / "chapter.txt").read_text() == "precious"


def test_a_model_that_cannot_be_replaced_is_kept(
    tiny_model: TrainedModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So is the new one: it may have taken hours."""
    version, rename = tiny_model.save(tmp_path / "model"), Path.replace

    def failing(path: Path, target: Path) -> Path:
        if target.name == "model" and not path.name.endswith("-former"):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return rename(path, target)

    monkeypatch.setattr(Path, "replace", failing)
    with pytest.raises(DrapemeterError, match="the new model is in") as caught:
        tiny_model.save(tmp_path / "model")
    assert caught.value.code == "model_not_replaced"
    new = Path(str(caught.value).split("the new model is in ")[1])
    assert load_model(tmp_path / "model").version == load_model(new).version == version


def test_a_model_of_another_format_is_to_be_trained_again(tmp_path: Path) -> None:
    (tmp_path / "weights.safetensors").touch()
    for stated in ('{"format": "drapemeter-model/0"}', "{}"):
        (tmp_path / "model.json").write_text(stated)
        with pytest.raises(InputError, match=r"reads drapemeter-model/1: train it again") as caught:
            load_model(tmp_path)
        assert caught.value.code == "model_format"


def test_damage_is_noticed(tiny_model: TrainedModel, tmp_path: Path) -> None:
    folder = tmp_path / "model"
    tiny_model.save(folder)
    weights = folder / "weights.safetensors"
    content = bytearray(weights.read_bytes())
    content[-1] ^= 1
    weights.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_model(folder)
    assert caught.value.code == "model_damaged"
    with pytest.raises(InputError, match="drapemeter train"):
        load_model(tmp_path / "nowhere")


def test_full_size_weights_stay_below_24_megabytes() -> None:
    from trainer.network import DrapeNetwork

    network = DrapeNetwork(NetworkConfig(height_channel=True))
    half = sum(p.numel() * (2 if p.dim() > 1 else 4) for p in network.state_dict().values())
    assert half < 24e6


def test_configurations_survive_json_and_are_checked() -> None:
    for config in PRESETS.values():
        assert TrainConfig.from_json(json.loads(json.dumps(config.to_json()))) == config


@pytest.mark.parametrize(
    ("bad", "code", "told"),
    [
        ({"momentum": 1}, "configuration_unknown_field", "unknown fields momentum: another version wrote it"),
        ({"network": {"depth": 50}}, "configuration_unknown_field", "unknown fields depth"),
        ({"inclinations": "fast"}, "configuration_value", "'fast' is none of upright, registered, as_seen"),
        ({"network": {"targets": "linear"}}, "configuration_value", "'linear' is none of log, log_per_weight"),
        ({"epochs": 0}, "training_length", "at least one epoch"),
        ({"batch_size": 1}, "training_length", "a batch of two pictures"),
        ({"train_share": 0.95}, "split_shares", "let them sum to less than 1"),
        ({"train_share": math.nan}, "split_shares", "between 0 and 1"),
        ({"calibration_share": 0.0}, "split_shares", "between 0 and 1"),
        ({"seed": -1}, "training_numbers", "cannot be negative"),
        ({"pictures_per_epoch": -5}, "training_numbers", "cannot be negative"),
        ({"mirror": 1.5}, "mirror", "must be a share from 0 to 1"),
        ({"learning_rate": -1.0}, "training_rate", "learning rate and threads must be positive"),
        ({"learning_rate": math.nan}, "training_rate", "learning rate and threads must be positive"),
        ({"learning_rate": math.inf}, "training_rate", "must be positive and finite"),
        ({"threads": 0}, "training_rate", "threads must be positive"),
        ({"workers": -1}, "training_rate", "workers not negative"),
        ({"network": {"input_size": 100}}, "input_size", "32, 64, 128 or 256"),
        ({"network": {"trunk_width": 9.0}}, "trunk_width", "from 0.05 to 2"),
        ({"network": {"equalise": False}}, "no_channels", "switch on equalise or height_channel"),
    ],
)
def test_configurations_without_meaning_are_refused(bad: dict[str, Any], code: str, told: str) -> None:
    with pytest.raises(InputError, match=told) as caught:
        TrainConfig.from_json(bad)
    assert caught.value.code == code


def test_a_preset_that_is_none_names_those_there_are() -> None:
    with pytest.raises(InputError, match=r"'best': choose standard, paper, quick") as caught:
        preset_config("best")
    assert caught.value.code == "preset_unknown"


def test_going_on_from_a_model(tiny_model: TrainedModel, tiny_config: TrainConfig) -> None:
    before = tiny_model.version
    config = replace(tiny_config, epochs=1, network=NetworkConfig(), learning_rate=1e-6, pretrained=True)
    further = train(SHORT, config, start=tiny_model)
    kept = tiny_model.scaling
    widened = replace(further.scaling, density_low=kept.density_low, density_high=kept.density_high)
    assert widened == kept and further.scaling.density_high >= kept.density_high
    assert further.config.network == tiny_model.config.network
    assert not further.config.pretrained and further.provenance["base_weights"] is None  # nothing began with ImageNet's
    assert further.provenance["start"]["model_version"] == before == tiny_model.version != further.version
    old, new = (m.network.trunk.conv1.weight for m in (tiny_model, further))
    assert torch.allclose(old, new, atol=1e-3)


def test_only_hanging_pictures_are_mirrored() -> None:
    pictures = torch.arange(2 * 2 * 9, dtype=torch.float32).reshape(2, 2, 1, 3, 3)
    mirrored = mirror_hanging(pictures, 1.0, seed=0)
    assert torch.equal(mirrored[:, 0], pictures[:, 0].flip(-1)) and torch.equal(mirrored[:, 1], pictures[:, 1])
    assert torch.equal(mirror_hanging(pictures, 0.0, seed=0), pictures)
    many = torch.arange(3.0).repeat(1000, 2, 1, 1, 1)
    half = (mirror_hanging(many, 0.5, seed=1)[:, 0, 0, 0, 0] == 2).float().mean()
    assert 0.4 < float(half) < 0.6


@dataclass(frozen=True)
class DamagedSource(AnalyticSource):
    """Analytic cloth of which one row cannot be read; ``shards`` lists those that rows were read of."""

    damaged: int = -1
    shards: list[int] = field(default_factory=list)

    def read(self, rows: NDArray[np.int64]) -> Tensor:
        read = self.table().take(rows)
        self.shards.extend(int(shard) for shard in np.unique(read.shard))
        if self.damaged in rows:
            raise StoreError(f"row {self.damaged} has no picture", code="store_damaged")
        return super().read(rows)


@pytest.mark.parametrize("part", ["calibration", "test"])
def test_damage_of_what_is_held_out_is_found_before_the_first_step(part: str, tiny_config: TrainConfig) -> None:
    """Training reads none of it, and takes hours."""
    config = replace(tiny_config, epochs=1)
    table = SHORT.table()
    row = int(table.of_materials(getattr(split_of(table, config), part)).row[-1])
    seen: list[Progress] = []
    with pytest.raises(StoreError, match=f"row {row} has no picture"):
        train(DamagedSource(SHORT.materials, SHORT.jitters, damaged=row), config, report=seen.append)
    assert not seen


@pytest.mark.parametrize("rank", [0, 1])
def test_what_is_held_out_is_read_once_by_one_rank(
    rank: int, tiny_config: TrainConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    for step in ("broadcast_state", "fit"):
        monkeypatch.setattr(trainer.train, step, lambda *_, **__: None)
    monkeypatch.setattr(trainer.train, "on_first", lambda work, partition: partition.rank or work())
    source = DamagedSource(SHORT.materials, SHORT.jitters)
    table = source.table()
    split = split_of(table, tiny_config)
    held_out = table.of_materials(np.concatenate([split.calibration, split.test]))
    trainer.train.learn(source, tiny_config, partition=Partition(rank, 2))
    assert source.shards == ([] if rank else np.unique(held_out.shard).tolist())


def test_tensorboard_events_when_asked(tiny_model: TrainedModel, tmp_path: Path) -> None:
    from trainer.tracking import TensorBoardLog

    seen: list[Progress] = []
    log = TensorBoardLog(tmp_path / "events", seen.append)
    log.report(Progress(40, 40, 0.5))
    log.finish(tiny_model.metrics)
    assert seen == [Progress(40, 40, 0.5)]
    (events,) = (tmp_path / "events").iterdir()
    assert b"train/squared_error" in events.read_bytes() and b"spearman/bending_bias/hanging" in events.read_bytes()
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    read = EventAccumulator(str(tmp_path / "events")).Reload()
    assert {event.step for tag in read.Tags()["scalars"] for event in read.Scalars(tag)} == {40}  # scores at the last


def test_a_step_that_is_told_of_again_is_written_once(tmp_path: Path) -> None:
    """Ranks are asked every half second, and their steps may take minutes; an interrupted log is closed."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from trainer.tracking import TensorBoardLog

    seen: list[Progress] = []
    steps = [Progress(step, 3, 0.5) for step in (1, 1, 1, 2, 2)]
    with pytest.raises(KeyboardInterrupt), TensorBoardLog(tmp_path, seen.append) as log:
        for step in steps:
            log.report(step)
        raise KeyboardInterrupt
    log.report(Progress(3, 3, 0.5))
    read = EventAccumulator(str(tmp_path)).Reload()
    assert [event.step for event in read.Scalars("train/squared_error")] == [1, 2]
    assert seen == [*steps, Progress(3, 3, 0.5)]


@pytest.mark.parametrize("written", [0, 1, 3])
def test_events_that_cannot_be_written_are_told_of_once(
    written: int, tiny_model: TrainedModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether the disk is full from the beginning, in the middle or at the scores; hours of training are behind it."""
    from tensorboard.summary.writer.record_writer import RecordWriter

    from trainer.tracking import TensorBoardLog

    records: list[bytes] = []

    def write(writer: RecordWriter, data: bytes) -> None:
        if len(records) == written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        records.append(data)

    monkeypatch.setattr(RecordWriter, "write", write)
    seen: list[Progress] = []
    told: list[str] = []
    log = TensorBoardLog(tmp_path / "events", seen.append, told.append)
    steps = [Progress(step, 2, 0.5) for step in (1, 2)]
    for step in steps:
        log.report(step)
    log.finish(tiny_model.metrics)
    assert seen == steps and len(records) == written
    (line,) = told
    assert line.startswith(f"{tmp_path / 'events'}: TensorBoard events cannot be written (No space left on device)")


def test_a_folder_of_events_that_cannot_be_made_is_told_of(tiny_model: TrainedModel, tmp_path: Path) -> None:
    from trainer.tracking import TensorBoardLog

    (tmp_path / "events").write_text("mine")
    told: list[str] = []
    log = TensorBoardLog(tmp_path / "events", tell=told.append)
    log.report(Progress(1, 1, 0.5))
    log.finish(tiny_model.metrics)
    assert len(told) == 1 and "File exists" in told[0] and (tmp_path / "events").read_text() == "mine"


def test_a_model_travels_to_a_process_without_torchvision(tiny_model: TrainedModel) -> None:
    import subprocess
    import sys

    sent = pickle.dumps(tiny_model)
    assert pickle.loads(sent).version == tiny_model.version
    program = "import pickle, sys; print(pickle.load(sys.stdin.buffer).version)"
    answer = subprocess.run([sys.executable, "-c", program], input=sent, capture_output=True, check=True)
    assert answer.stdout.decode().strip() == tiny_model.version


def test_what_the_earlier_model_learnt_from_is_not_held_out(tiny_config: TrainConfig) -> None:
    config = replace(tiny_config, epochs=1)
    source = AnalyticSource(materials=24, jitters=1)
    first = train(source, config)
    table = source.table()
    known = split_of(table, config).train
    other = replace(config, seed=7, train_share=config.train_share + 0.1)
    usual = split_of(table, other)
    assert np.intersect1d(usual.calibration, known).size  # else this shows nothing
    split = split_of(table, other, first)
    assert (len(split.calibration), len(split.test)) == (len(usual.calibration), len(usual.test))  # others are left
    for held_out in (split.calibration, split.test):
        assert len(held_out) and not np.intersect1d(held_out, known).size
    everything = np.concatenate([split.train, split.calibration, split.test])
    assert sorted(everything.tolist()) == sorted(np.unique(table.material).tolist())
    second = train(source, other, start=first)
    assert set(first.provenance["learnt"]) < set(second.provenance["learnt"])
    assert "learnt" not in second.provenance["start"]["provenance"]
    fewer = split_of(table.of_materials(np.concatenate([known, split.test[:1], split.calibration[:1]])), other, first)
    assert (len(fewer.calibration), len(fewer.test)) == (1, 1)
    with pytest.raises(InputError, match=f"all but 1 of the store's {len(known) + 1} fabrics") as caught:
        split_of(table.of_materials(np.append(known, split.test[0])), other, first)
    assert caught.value.code == "start_knows_fabrics"
