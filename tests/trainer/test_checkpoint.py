"""A training that is interrupted goes on to the very model that it would have come to."""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
import torch

from simcore.errors import InputError
from trainer import checkpoint
from trainer.checkpoint import CheckpointFile, checkpoint_place
from trainer.config import AugmentConfig, TrainConfig
from trainer.model import TrainedModel
from trainer.train import Progress, train

from .analytic import AnalyticSource

SOURCE = AnalyticSource(materials=12, jitters=1)
STEPS = 12


@pytest.fixture(scope="module")
def config(tiny_config: TrainConfig) -> TrainConfig:
    """Three epochs of four steps, with everything in them that is drawn at random."""
    network = replace(tiny_config.network, dropout=0.3)
    return replace(tiny_config, network=network, augment=AugmentConfig(), mirror=0.5, epochs=3, batch_size=4)


@pytest.fixture(scope="module")
def whole(config: TrainConfig) -> TrainedModel:
    """What the training comes to that nothing interrupts."""
    return train(SOURCE, config)


@dataclass
class Place:
    """Where a test's training is kept, with what was told of it."""

    path: Path
    told: list[str] = field(default_factory=list)

    def file(self, resume: bool = False) -> CheckpointFile:
        return CheckpointFile(self.path, resume, self.told.append)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Place:
    """The state is kept every four steps."""
    monkeypatch.setattr(checkpoint, "STEPS_BETWEEN", 4)
    return Place(tmp_path / "model.checkpoint")


def interrupting(step: int) -> Callable[[Progress], None]:
    def report(progress: Progress) -> None:
        if progress.step == step:
            raise KeyboardInterrupt

    return report


def interrupt(config: TrainConfig, place: Place, step: int, source: AnalyticSource = SOURCE) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(source, config, report=interrupting(step), checkpoints=place.file())


@pytest.mark.parametrize(("step", "kept"), [(4, 4), (6, 4), (11, 8), (STEPS, STEPS)])
def test_a_resumed_training_gives_the_same_network_to_the_bit(
    step: int, kept: int, config: TrainConfig, whole: TrainedModel, place: Place
) -> None:
    """Behind an epoch, within one, twice through the pictures, and with the calibration alone to be done."""
    interrupt(config, place, step)
    steps: list[Progress] = []
    resumed = train(SOURCE, config, report=steps.append, checkpoints=place.file(resume=True))
    for name, tensor in whole.network.state_dict().items():
        assert torch.equal(resumed.network.state_dict()[name], tensor), name
    assert resumed.version == whole.version
    assert [progress.step for progress in steps] == list(range(kept + 1, STEPS + 1))
    assert place.told == [f"{place.path}: the training goes on behind step {kept}"]


def test_a_training_may_be_interrupted_again(config: TrainConfig, whole: TrainedModel, place: Place) -> None:
    interrupt(config, place, 5)
    with pytest.raises(KeyboardInterrupt):
        train(SOURCE, config, report=interrupting(9), checkpoints=place.file(resume=True))
    steps: list[Progress] = []
    resumed = train(SOURCE, config, report=steps.append, checkpoints=place.file(resume=True))
    assert resumed.version == whole.version and steps[0].step == 9


def test_keeping_the_state_changes_nothing(config: TrainConfig, whole: TrainedModel, place: Place) -> None:
    assert train(SOURCE, config, checkpoints=place.file()).version == whole.version and place.path.is_file()


def test_a_training_that_went_on_from_a_model_is_resumed(
    config: TrainConfig, whole: TrainedModel, place: Place
) -> None:
    short = replace(config, epochs=2)
    source = AnalyticSource(materials=24, jitters=1, seed=1)
    with pytest.raises(KeyboardInterrupt):
        train(source, short, start=whole, report=interrupting(6), checkpoints=place.file())
    resumed = train(source, short, start=whole, checkpoints=place.file(resume=True))
    assert resumed.version == train(source, short, start=whole).version
    with pytest.raises(InputError, match=f"start \\(then {whole.version}, now none\\)"):
        train(source, short, checkpoints=place.file(resume=True))


@pytest.mark.parametrize(
    ("other", "source", "named"),
    [
        ({"learning_rate": 1e-3}, SOURCE, r": learning_rate \(then 0\.004, now 0\.001\); resume with"),
        ({"augment": AugmentConfig.off()}, SOURCE, r": augment\.thin_plate \(then 0\.3, now 0\), augment\.perspective"),
        ({"seed": 1}, SOURCE, r": seed \(then 0, now 1\), split \(then \w+, now \w+\); resume"),
        ({}, replace(SOURCE, seed=1), r": pictures \(then \w+, now \w+\); resume"),
    ],
)
def test_a_checkpoint_of_another_training_is_refused_by_what_differs(
    other: dict[str, object], source: AnalyticSource, named: str, config: TrainConfig, place: Place
) -> None:
    interrupt(config, place, 4)
    before = place.path.read_bytes()
    steps: list[Progress] = []
    with pytest.raises(InputError, match=named) as caught:
        train(source, replace(config, **other), report=steps.append, checkpoints=place.file(resume=True))  # type: ignore[arg-type]
    assert caught.value.code == "checkpoint_of_another_run"
    assert not steps and place.path.read_bytes() == before


def test_a_checkpoint_of_another_version_of_the_program_is_refused(
    config: TrainConfig, place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt(config, place, 4)
    monkeypatch.setattr("trainer.same_run.TRAINING_VERSION", 1000)
    with pytest.raises(InputError, match=r"program \(then 1, now 1000\)"):
        train(SOURCE, config, checkpoints=place.file(resume=True))


def test_a_checkpoint_of_other_statements_of_the_store_is_refused(config: TrainConfig, place: Place) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(SOURCE, config, provenance={"seed": 1}, report=interrupting(4), checkpoints=place.file())
    with pytest.raises(InputError, match=r": stores \(then \w+, now \w+\); resume"):
        train(SOURCE, config, provenance={"seed": 2}, checkpoints=place.file(resume=True))


@pytest.mark.parametrize("left", [0, 1, 70, 1000, -1])
def test_a_checkpoint_that_was_cut_short_is_refused(left: int, config: TrainConfig, place: Place) -> None:
    interrupt(config, place, 4)
    place.path.write_bytes(place.path.read_bytes()[:left])
    with pytest.raises(InputError, match=r"cannot be read as a checkpoint \(cut short, damaged") as caught:
        train(SOURCE, config, checkpoints=place.file(resume=True))
    assert caught.value.code == "checkpoint_damaged"


def test_one_turned_bit_is_noticed(config: TrainConfig, place: Place) -> None:
    interrupt(config, place, 4)
    content = bytearray(place.path.read_bytes())
    content[len(content) // 2] ^= 1
    place.path.write_bytes(content)
    with pytest.raises(InputError, match="remove it to train anew"):
        place.file(resume=True).read({})


class Harm:
    """Makes a folder where it is unpickled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[object, ...]:
        return (os.mkdir, (str(self.folder),))


def test_nothing_in_a_checkpoint_is_executed(place: Place) -> None:
    folder, content = place.path.with_name("harm"), io.BytesIO()
    torch.save({"run": {}, "state": Harm(folder)}, content)
    place.path.write_bytes(content.getvalue() + checkpoint._seal(content.getvalue()))
    with pytest.raises(InputError) as caught:
        place.file(resume=True).read({})
    assert caught.value.code == "checkpoint_damaged" and not folder.exists()


def test_a_folder_in_its_place_is_told(place: Place) -> None:
    place.path.mkdir()
    with pytest.raises(InputError, match=r"cannot be read as a checkpoint \(Is a directory\)"):
        place.file(resume=True).read({})


def test_an_unfinished_training_is_neither_overwritten_nor_missed(place: Place) -> None:
    place.file().check()
    with pytest.raises(InputError, match=r"is not there, .*: leave out --resume") as caught:
        place.file(resume=True).check()
    assert caught.value.code == "checkpoint_missing"
    place.path.write_text("of hours")
    place.file(resume=True).check()
    with pytest.raises(InputError, match="give --resume to go on with it, or remove the file") as caught:
        place.file().check()
    assert caught.value.code == "training_unfinished" and place.path.read_text() == "of hours"


def test_a_full_disk_is_told_of_once_and_ends_no_training(
    config: TrainConfig, whole: TrainedModel, place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is tried again, and what was safe stays."""
    room = [True, False, False]
    tried: list[bool] = []

    def fsync(number: int) -> None:
        tried.append(room[len(tried)])
        if not tried[-1]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr("renderer.atomic.os.fsync", fsync)
        assert train(SOURCE, config, checkpoints=place.file()).version == whole.version
    assert tried == room
    (line,) = place.told
    assert line.startswith(f"cannot write {place.path}: No space left on device")
    assert line.endswith("the training goes on; interrupted by now, it would have to go on behind step 4")
    assert [path.name for path in place.path.parent.iterdir()] == [place.path.name]
    assert train(SOURCE, config, checkpoints=place.file(resume=True)).version == whole.version


def test_it_lies_beside_what_a_link_names(tmp_path: Path) -> None:
    """As the model does, whichever way the folder is named."""
    (tmp_path / "disk" / "m").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "disk" / "m")
    beside = (tmp_path / "disk" / "m.checkpoint").resolve()
    assert checkpoint_place(tmp_path / "link") == checkpoint_place(tmp_path / "disk" / "m") == beside
