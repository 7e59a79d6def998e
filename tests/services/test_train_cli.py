"""`drapemeter train` and `drapemeter estimate`, from a store to an estimate."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from capture.capture_set import Capture, new_document, write_captures_json
from capture.normalise import NetworkInput
from capture.prepare import PreparedCapture, prepare_all
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth_png import write_depth_png
from renderer.store import RowStatus, ShardRows, StoreLayout, StoreWriter
from services.cli import main
from services.training.job import TrainingRank
from simcore.parameters import ESTIMATED_NAMES, UNITS
from simcore.scenes import Scene
from tests.trainer.analytic import AnalyticSource
from trainer import ablation, evaluate_captures, saliency
from trainer.config import NetworkConfig, TrainConfig
from trainer.model import TrainedModel, load_model
from trainer.network import DrapeNetwork
from trainer.predict import Estimator
from trainer.tracking import TensorBoardLog
from trainer.train import Progress

QUICK = ["--preset", "quick", "--epochs", "1", "--trunk-width", "0.125"]


def depth_counts(source: AnalyticSource, rows: np.ndarray) -> np.ndarray:
    """The analytic cloth as the store holds it: 0.1 mm of depth, 256 x 256."""
    heights = np.kron(source.read(rows).numpy(), np.ones((1, 4, 4), dtype=np.int16))
    return (9000 - heights).astype(np.uint16)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = AnalyticSource(materials=16, jitters=1)
    table = source.table()
    layout = StoreLayout(
        materials=16,
        scenes=("hanging", "stretch"),
        jitters=1,
        inclinations_deg=(0.0,),
        simulations_per_shard=8,
        vertex_count=4,
    )
    path = tmp_path_factory.mktemp("store") / "s.zarr"
    writer = StoreWriter.create(path, layout, configuration={"made": "by hand"}, seed=1, software_version="test")
    for shard in range(layout.shards):
        rows = np.asarray(layout.shard_rows(shard))
        count = len(rows)
        writer.write_shard(
            shard,
            ShardRows(
                depth=depth_counts(source, rows),
                parameters=table.parameters[rows].astype(np.float32),
                scene=table.scene[rows].astype(np.uint8),
                status=np.full(count, RowStatus.OK, dtype=np.uint8),
                reason=np.full(count, "", dtype=object),
                inclination_deg=np.zeros(count, dtype=np.float32),
                seed=np.zeros(count, dtype=np.uint64),
                material=table.material[rows].astype(np.uint32),
                jitter=np.zeros(count, dtype=np.uint32),
                vertices=np.zeros((count, 4, 3), dtype=np.float32),
                residual=np.zeros(count),
                energy=np.zeros(count),
            ),
        )
    return path


@pytest.fixture(scope="module")
def model(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained") / "model"
    assert main.run(["train", "--store", str(store), "--out", str(folder), *QUICK]) == 0
    return folder


@pytest.fixture
def capture_set(tmp_path: Path) -> Path:
    return make_capture_set(tmp_path / "set", {"f1": 0.2, "f2": None})


def make_capture_set(folder: Path, densities: dict[str, float | None]) -> Path:
    """Two scenes of each fabric, seen by the canonical camera."""
    source = AnalyticSource(materials=len(densities), jitters=1)
    folder.mkdir()
    captures = []
    for row, (fabric, scene) in enumerate((f, s) for f in densities for s in ("hanging", "stretch")):
        name = f"{fabric}-{scene}-0"
        write_depth_png(folder / f"{name}.png", depth_counts(source, np.array([row]))[0] * np.float32(1e-4))
        captures.append({"id": name, "fabric": fabric, "scene": scene, "repeat": 0, "depth": f"{name}.png"})
    document = new_document(
        name="analytic",
        camera=CANONICAL_CAMERA,
        fabrics=[{"id": fabric, "density": density} for fabric, density in densities.items()],
        captures=captures,
        setup={"camera_from_panel": frontal_pose().tolist()},
    )
    write_captures_json(document, folder)
    return folder


def run_json(capsys: pytest.CaptureFixture[str], *arguments: str) -> Any:
    capsys.readouterr()
    assert main.run([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def failure(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    capsys.readouterr()
    code = main.run(list(arguments))
    said = capsys.readouterr().err.strip()
    assert "\n" not in said and "Traceback" not in said
    return code, said


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


def test_estimate_prints_one_document(model: Path, capture_set: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = run_json(capsys, "estimate", str(capture_set), "--density", "0.15", "--model", str(model))
    assert [f["id"] for f in document["fabrics"]] == ["f1", "f2"]
    assert [f["density"] for f in document["fabrics"]] == [0.2, 0.15]
    assert document["units"] == {name: UNITS[name] for name in ESTIMATED_NAMES}
    assert len(document["model_version"]) == 16
    for fabric in document["fabrics"]:
        assert list(fabric["parameters"]) == list(ESTIMATED_NAMES)
        assert all(low <= fabric["parameters"][n] <= high for n, (low, high) in fabric["intervals_90"].items())
        assert fabric["scenes"] == ["hanging", "stretch"] and isinstance(fabric["out_of_distribution"], bool)
        assert fabric["intervals_calibrated"] is False  # three fabrics calibrate nothing


def test_a_fabric_without_captures_is_told_of(
    model: Path, capture_set: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = capture_set / "captures.json"
    document = json.loads(path.read_text())
    document["fabrics"].append({"id": "f3", "density": 0.2})
    path.write_text(json.dumps(document))
    assert main.run(["estimate", str(capture_set), "--density", "0.15", "--model", str(model), "--json"]) == 0
    said = capsys.readouterr()
    assert [f["id"] for f in json.loads(said.out)["fabrics"]] == ["f1", "f2"]
    assert "no captures of f3" in said.err


def test_estimate_prints_a_table(model: Path, capture_set: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["estimate", str(capture_set), "--density", "0.15", "--model", str(model)]) == 0
    said, told = capsys.readouterr()
    assert all(f"{name} " in said for name in ESTIMATED_NAMES) and "N·m" in said and "f2: 0.15 kg/m²" in said
    assert "the intervals promise nothing" in said
    assert "--density is not used for f1: the set states it" in told


def test_a_missing_density_names_the_fabric(model: Path, capture_set: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = failure(capsys, "estimate", str(capture_set), "--model", str(model))
    assert code == 2 and "f2" in said and "f1," not in said and "--density" in said
    assert said.endswith("[density_missing]")


def test_bad_input_is_told_in_one_line(
    model: Path, capture_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, here = str(tmp_path / "new"), str(tmp_path)
    cases = [
        (["estimate", str(capture_set), "--density", "200", "--model", str(model)], "kg/m²"),
        (["estimate", str(capture_set), "--density", "nan", "--model", str(model)], "kg/m²"),
        (["estimate", here, "--density", "0.2", "--model", str(model)], "captures.json"),
        (["estimate", str(capture_set), "--density", "0.2", "--model", here], "drapemeter train"),
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


def test_an_empty_picture_is_refused(model: Path, capture_set: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flat = np.full((256, 256), 0.9, dtype=np.float32)
    write_depth_png(capture_set / "f1-hanging-0.png", flat)
    code, said = failure(capsys, "estimate", str(capture_set), "--density", "0.2", "--model", str(model))
    assert code == 2 and "f1" in said


def test_a_fabric_whose_picture_is_empty_is_named(
    capture_set: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where the emptiness shows in what the network sees alone."""
    network = DrapeNetwork(NetworkConfig(input_size=64, trunk_width=0.125)).eval()
    stub = SimpleNamespace(network=network, config=TrainConfig(network=network.config), version="v", provenance={})
    monkeypatch.setattr("trainer.predict.Estimator.load", lambda folder: Estimator(cast(TrainedModel, stub)))

    def inputs(*_: object) -> dict[str, dict[str, list[NetworkInput]]]:
        flat = NetworkInput(np.zeros((256, 256), np.float32), np.ones((256, 256), np.bool_), Scene.HANGING)
        return {fabric: {"hanging": [flat]} for fabric in ("f1", "f2")}

    monkeypatch.setattr("capture.prepare.inputs_by_fabric", inputs)
    code, said = failure(capsys, "estimate", str(capture_set), "--density", "0.2")
    assert code == 2 and said.startswith("error: fabric 'f1': picture 1 of 1 of hanging shows no cloth")
    assert said.endswith("[no_cloth]")


def test_the_real_capture(model: Path, shared_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = str(shared_dir / "real" / "phisft-r1")
    document = run_json(capsys, "estimate", place, "--density", "0.2", "--model", str(model))
    (fabric,) = document["fabrics"]
    assert len(fabric["parameters"]) == 6 and fabric["scenes"] == ["hanging"]
    code, said = failure(capsys, "estimate", place, "--model", str(model))
    assert code == 2 and "--density" in said


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


def test_scores_on_captures_of_known_fabrics(model: Path, tmp_path: Path) -> None:
    from trainer.evaluate_captures import evaluate_captures, known_fabrics, markdown
    from trainer.predict import Estimator

    folder = make_capture_set(tmp_path / "set", {"f1": 0.2, "f2": 0.3, "f3": None})
    document = json.loads((folder / "captures.json").read_text())
    for fabric in document["fabrics"]:
        fabric["parameters"] = dict.fromkeys(ESTIMATED_NAMES[:3], 300.0) | dict.fromkeys(ESTIMATED_NAMES[3:], 1e-5)
    (folder / "captures.json").write_text(json.dumps(document))
    fabrics = known_fabrics([folder])
    assert [f.name for f in fabrics] == ["set/f1", "set/f2"]  # the third has no density
    scores = evaluate_captures(Estimator.load(model), fabrics)
    assert list(scores) == ["hanging", "stretch", "hanging+stretch"]
    assert all(score.mae_log > 0 for rows in scores.values() for score in rows.values())
    assert len(markdown(scores).splitlines()) == 8


def test_captures_of_unknown_fabrics_have_no_scores(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = make_capture_set(tmp_path / "set", {"f1": 0.2}), tmp_path / "scores.json"
    arguments = [str(folder), "--model", str(model), "--out", str(out)]
    monkeypatch.setattr(sys, "argv", [evaluate_captures.__name__, *arguments])
    with pytest.raises(SystemExit) as ended:
        evaluate_captures.main()
    said = capsys.readouterr().err
    assert ended.value.code == 2 and "states both parameters and density" in said
    assert said.endswith("[no_known_fabrics]\n") and not out.exists()


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


def test_poses_are_found_from_the_whole_set(
    monkeypatch: pytest.MonkeyPatch, model: Path, capture_set: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[int] = []

    def prepare(captures: Sequence[Capture]) -> list[PreparedCapture]:
        seen.append(len(captures))
        return prepare_all(captures)

    monkeypatch.setattr("capture.prepare.prepare_all", prepare)
    document = run_json(capsys, "estimate", str(capture_set), "--density", "0.15", "--model", str(model))
    assert seen == [4] and [fabric["scenes"] for fabric in document["fabrics"]] == [["hanging", "stretch"]] * 2


@pytest.mark.parametrize("program", [evaluate_captures, saliency, ablation])
def test_side_programs_tell_bad_input_in_one_line(
    program: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    nothing = str(tmp_path / "nothing")
    arguments = {
        evaluate_captures: [nothing],
        saliency: ["--model", nothing, "--store", nothing, "--out", nothing],
        ablation: ["--store", nothing, "--out", nothing, "--pretrained"],
    }[program]
    monkeypatch.setattr(sys, "argv", [program.__name__, *arguments])
    with pytest.raises(SystemExit) as ended:
        program.main()
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.startswith("error: ") and said.count("\n") == 1
    assert not Path(nothing).exists()
