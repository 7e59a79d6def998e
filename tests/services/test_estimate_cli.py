"""`drapemeter estimate`, and the programs that judge a model on captures and stores."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import cast

import numpy as np
import pytest

from capture.camera_rig import AT_ODDS
from capture.capture_set import Capture
from capture.normalise import NetworkInput
from capture.prepare import PreparedCapture, prepare_all
from capture.register import HIDDEN
from capture.report import BY_EDGES_ALONE
from renderer.depth_png import write_depth_png
from services.cli import main
from simcore.parameters import ESTIMATED_NAMES, UNITS
from simcore.scenes import Scene
from tests.services.analytic_store import failure, make_capture_set, run_json
from trainer import ablation, evaluate_captures, saliency
from trainer.config import NetworkConfig, TrainConfig
from trainer.model import TrainedModel
from trainer.network import DrapeNetwork
from trainer.predict import Estimator


@pytest.fixture
def capture_set(tmp_path: Path) -> Path:
    return make_capture_set(tmp_path / "set", {"f1": 0.2, "f2": None})


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
    here = str(tmp_path)
    cases = [
        ([str(capture_set), "--density", "200", "--model", str(model)], "kg/m²"),
        ([str(capture_set), "--density", "nan", "--model", str(model)], "kg/m²"),
        ([here, "--density", "0.2", "--model", str(model)], "captures.json"),
        ([str(capture_set), "--density", "0.2", "--model", here], "drapemeter train"),
    ]
    for arguments, words in cases:
        code, said = failure(capsys, "estimate", *arguments)
        assert code == 2 and words in said, (arguments, said)


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


def test_scores_on_captures_of_known_fabrics(model: Path, tmp_path: Path) -> None:
    from trainer.evaluate_captures import as_json, evaluate_captures, known_fabrics, markdown
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
    plain = as_json(scores)["hanging"]["stretch_warp"]
    assert "mae_own_range" in plain and "mae_range" not in plain


def test_scores_come_with_what_speaks_against_the_poses(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_capture_set(tmp_path / "set", {"f1": 0.2, "f2": 0.3})
    document = json.loads((folder / "captures.json").read_text())
    for fabric in document["fabrics"]:
        fabric["parameters"] = dict.fromkeys(ESTIMATED_NAMES[:3], 300.0) | dict.fromkeys(ESTIMATED_NAMES[3:], 1e-5)
    (folder / "captures.json").write_text(json.dumps(document))
    monkeypatch.setattr(evaluate_captures, "prepare_all", doubtful)
    monkeypatch.setattr(sys, "argv", [evaluate_captures.__name__, str(folder), "--model", str(model)])
    evaluate_captures.main()
    captured = capsys.readouterr()
    assert f"set/f2: capture f2-hanging-0, f2-stretch-0: {AT_ODDS}\n" in captured.err
    assert AT_ODDS not in captured.out and len(captured.out.splitlines()) == 8


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


def doubtful(captures: Sequence[Capture]) -> Iterator[PreparedCapture]:
    """As :func:`prepare_all`; of all four poses something is unusual, and of one scene's they are of edges alone."""
    assert len(captures) == 4
    for one in prepare_all(captures):
        method = "panel_and_edges" if one.capture.scene is Scene.STRETCH else "panel_and_pins"
        found = replace(one.registration, unusual=(AT_ODDS, HIDDEN), method=method, pin_error_m=0.02)
        yield replace(one, registration=found)


def test_poses_are_found_from_the_whole_set_and_what_speaks_against_them_is_noted_by_fabric(
    monkeypatch: pytest.MonkeyPatch, model: Path, capture_set: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["estimate", str(capture_set), "--density", "0.15", "--model", str(model)]
    assert [f["notes"] for f in run_json(capsys, *asked)["fabrics"]] == [[], []]
    monkeypatch.setattr("capture.prepare.prepare_all", doubtful)
    document = run_json(capsys, *asked)
    assert [fabric["scenes"] for fabric in document["fabrics"]] == [["hanging", "stretch"]] * 2
    for name, fabric in zip(("f1", "f2"), document["fabrics"], strict=True):
        far, odds, alone = fabric["notes"]
        both = f"capture {name}-hanging-0, {name}-stretch-0: "
        assert far.startswith(f"{both}the pinned corners are 20 mm from") and odds == both + AT_ODDS
        assert alone == f"capture {name}-stretch-0: {BY_EDGES_ALONE}"
    assert main.run(asked) == 0
    said = capsys.readouterr().out
    assert all(f"\n  {note}\n" in said for fabric in document["fabrics"] for note in fabric["notes"])


def test_a_density_beyond_the_trained_ones_is_not_laid_on_the_captures(
    model: Path, capture_set: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["estimate", str(capture_set), "--model", str(model), "--density"]
    like = "these captures are unlike the training pictures"

    def told(density: str) -> str:
        capsys.readouterr()
        assert main.run([*asked, density]) == 0
        return capsys.readouterr().out.split("f2: ")[1]

    usual, heavy = told("0.2"), told("4.9")
    assert "the density 4.9 kg/m² is beyond the " in heavy and "density" not in usual
    assert heavy.count(like) == usual.count(like) == 0
    stated, beyond = (f["out_of_distribution_reasons"] for f in run_json(capsys, *asked, "4.9")["fabrics"])
    assert beyond[-1].startswith("the density 4.9 kg/m² is beyond the ")
    assert f"do not rely on the estimate: {'; '.join(beyond)}\n" in heavy
    assert not [reason for reason in stated if "density" in reason]  # the set states its density


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
