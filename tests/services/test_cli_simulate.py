"""`drapemeter simulate`: the contract's document, same seed same bits, one clear line for each bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from capture.capture_set import CaptureSet
from diagnosis.effects import parse_effect
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth_png import read_depth_png
from renderer.ply import read_ply
from services.cli import main
from services.cli.simulate import completed

FABRIC = {
    "stretch_warp": 1000.0,
    "stretch_weft": 800.0,
    "stretch_bias": 300.0,
    "bending_warp": 1e-4,
    "bending_weft": 1e-4,
    "bending_bias": 1e-4,
    "density": 0.2,
}


@pytest.fixture
def parameters(tmp_path: Path) -> Path:
    path = tmp_path / "p.json"
    path.write_text(json.dumps(FABRIC))
    return path


def command(parameters: Path, out: Path, *more: str, resolution: str = "0.025") -> list[str]:
    head = ["simulate", "--scene", "hanging", "--parameters", str(parameters), "--resolution", resolution]
    return [*head, "--out", str(out), *more]


def test_the_same_seed_twice_gives_the_same_bits(
    parameters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    contents = []
    for name in ("a", "b"):
        out, depth = tmp_path / f"{name}.ply", tmp_path / f"{name}.png"
        assert main.run(command(parameters, out, "--seed", "3", "--depth", str(depth), "--json")) == 0
        document = json.loads(capsys.readouterr().out)
        assert set(document) >= {"status", "residual", "energy", "stable", "iterations", "seconds"}
        assert document["status"] == "still"
        assert document["residual"] < 1e-3
        contents.append((out.read_bytes(), depth.read_bytes()))
    assert contents[0] == contents[1]
    assert main.run(command(parameters, tmp_path / "c.ply", "--seed", "4")) == 0
    assert (tmp_path / "c.ply").read_bytes() != contents[0][0]
    assert {path.name for path in tmp_path.iterdir()} == {"p.json", "a.ply", "a.png", "b.ply", "b.png", "c.ply"}


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"density": float("nan")}, "parameter_out_of_range"),
        ({"stretch_warp": -1.0}, "parameter_out_of_range"),
        ({"bending_weft": 5.0}, "parameter_out_of_range"),
        ({"bending_weft": "soft"}, "parameter_not_a_number"),
        ({"density": None}, "parameter_missing"),
    ],
)
def test_unusable_parameters_exit_2_and_write_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, object], code: str
) -> None:
    path = tmp_path / "p.json"
    path.write_text(json.dumps({**FABRIC, **change}))
    assert main.run(command(path, tmp_path / "a.ply", "--json")) == 2
    expect_one_line(capsys, code)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--scene", "flying"], "scene_unknown"),
        (["--resolution", "0.007"], "resolution_does_not_divide"),
        (["--resolution", "nan"], "resolution_out_of_range"),
        (["--parameters", "missing.json"], "file_missing"),
        (["--out", "missing/a.ply"], "folder_missing"),
        (["--out", "."], "output_is_folder"),
        (["--depth", "missing/d.png"], "folder_missing"),
        (["--depth", "a.ply"], "output_twice"),
        (["--out", "p.json"], "output_is_input"),
        (["--depth", "p.json"], "output_is_input"),
        (["--out", "link.ply"], "folder_missing"),
        (["--depth", "d.png", "--effect", "camera_translation=tz:-2"], "camera_behind_panel"),
        (["--depth", "d.png", "--effect", "camera_rotation=rx:180"], "picture_empty"),
        (["--depth", "d.png", "--effect", "dropout=1"], "picture_empty"),
        (["--capture-set", "set", "--effect", "depth_bias=6"], "depth_overflow"),
        (["--seed", "-1"], "seed_negative"),
        (["--seed", "one"], "usage"),
        (["--effect", "wind=1"], "effect_unknown"),
        (["--effect", "air_draft"], "effect_magnitude"),
        (["--effect", "air_draft=strong"], "effect_magnitude"),
        (["--effect", "air_draft=nan"], "effect_magnitude"),
        (["--effect", "air_draft=0.1", "--effect", "air_draft=0.2"], "effect_twice"),
    ],
)
def test_bad_arguments_exit_2_and_write_nothing(
    parameters: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: str,
) -> None:
    def solve(*_: object, **__: object) -> None:
        raise AssertionError("refused after the drape was simulated")

    monkeypatch.setattr("simcore.solver.Solver.solve", solve)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link.ply").symlink_to(tmp_path / "missing" / "a.ply")
    assert main.run([*command(parameters, Path("a.ply")), *arguments]) == 2
    expect_one_line(capsys, code)
    assert {path.name for path in tmp_path.iterdir()} == {parameters.name, "link.ply"}
    assert json.loads(parameters.read_text()) == FABRIC


def test_an_effect_on_pictures_alone_changes_no_drape(
    parameters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain, scaled = tmp_path / "plain.ply", tmp_path / "scaled.ply"
    assert main.run(command(parameters, plain)) == 0
    assert main.run(command(parameters, scaled, "--effect", "depth_scale=0.02")) == 0
    assert "depth_scale changes the picture alone" in capsys.readouterr().err
    assert read_ply(scaled).vertices.tolist() == read_ply(plain).vertices.tolist()


def test_effects_change_drape_and_picture(parameters: Path, tmp_path: Path) -> None:
    plain, drafty = tmp_path / "plain.ply", tmp_path / "drafty.ply"
    near, far = tmp_path / "near.png", tmp_path / "far.png"
    stretch = ["--scene", "stretch"]
    assert main.run(command(parameters, plain, *stretch)) == 0
    assert main.run(command(parameters, drafty, *stretch, "--effect", "air_draft=0.4")) == 0
    assert read_ply(drafty).vertices[:, 2].mean() > read_ply(plain).vertices[:, 2].mean()
    assert main.run(command(parameters, plain, "--depth", str(near))) == 0
    assert main.run(command(parameters, plain, "--depth", str(far), "--effect", "depth_scale=0.02")) == 0
    ratio = read_depth_png(far) / read_depth_png(near)
    assert np.median(ratio) == pytest.approx(1.02, abs=5e-4)


def test_pictures_add_up_to_a_capture_set(parameters: Path, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    for seed in ("0", "1"):
        arguments = command(parameters, tmp_path / "a.ply", "--seed", seed, "--capture-set", str(folder))
        assert main.run([*arguments, "--fabric", "f1", "--effect", "camera_translation=tx:0.02"]) == 0
    captures = CaptureSet.load(folder).captures
    assert [(c.fabric.id, c.scene, c.repeat) for c in captures] == [("f1", "hanging", 0), ("f1", "hanging", 1)]
    assert captures[0].fabric.density == FABRIC["density"]
    stated = captures[0].fabric.parameters
    assert stated is not None and stated.stretch_warp == FABRIC["stretch_warp"]
    assert captures[0].camera == CANONICAL_CAMERA
    assert np.array_equal(captures[0].camera_from_panel, frontal_pose())  # nominal: the effect is not given away


def expect_one_line(capsys: pytest.CaptureFixture[str], code: str) -> None:
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.endswith(f"[{code}]\n")
    assert captured.err.count("\n") == 1


@pytest.mark.parametrize(
    "effect", ["depth_bias=6", "quantisation=-0.002", "range_noise=-0.001", "sensor_smoothing=-1", "range_noise=1e200"]
)
def test_a_picture_that_cannot_be_leaves_nothing(
    parameters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], effect: str
) -> None:
    depth = tmp_path / "d.png"
    assert main.run(command(parameters, tmp_path / "o.ply", "--depth", str(depth), "--effect", effect)) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["p.json"]


def test_one_file_under_two_names_and_an_id_without_a_set_are_refused(
    parameters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sub").mkdir()
    out = tmp_path / "o"
    assert main.run(command(parameters, out, "--depth", str(tmp_path / "sub" / ".." / "o"))) == 2
    assert "[output_twice]" in capsys.readouterr().err
    assert main.run(command(parameters, out, "--fabric", "f")) == 2
    assert "[fabric_without_set]" in capsys.readouterr().err
    assert not out.exists()


def test_magnets_of_another_size_make_another_drape(parameters: Path, tmp_path: Path) -> None:
    drapes = []
    for radius in ("0", "0.01", "0.06"):
        out = tmp_path / f"{radius}.ply"
        assert main.run(command(parameters, out, "--pin-radius", radius)) == 0
        drapes.append(out.read_bytes())
    assert main.run(command(parameters, tmp_path / "n.ply")) == 0
    assert (tmp_path / "n.ply").read_bytes() == drapes[1] != drapes[2]
    assert main.run(command(parameters, tmp_path / "x.ply", "--pin-radius", "0.3")) == 2


def test_a_plate_that_cannot_be_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "p.json"
    path.write_text(json.dumps({**FABRIC, "bending_warp": 1e-3, "bending_weft": 1e-5, "bending_bias": 1e-8}))
    assert main.run(command(path, tmp_path / "o.ply")) == 0
    told = capsys.readouterr().err
    assert "bending_bias of 1e-08" in told and "simulated with 0.0002" in told


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("crease=1.2", "magnitude 1.2, down 1, position 0.5"),
        ("crease=down:0", "magnitude 0.866, down 0, position 0.5"),
        ("rest_curvature=magnitude:6,warp:1", "magnitude 6, weft 0, warp 1"),
        ("camera_translation=0.01", "tx 0.01, ty 0, tz 0 [m]"),
        ("camera_translation=tx:0.01", ""),
        ("crease=magnitude:1,down:1,position:0.5", ""),
        ("bending_hysteresis=magnitude:10", ""),  # its seed is chance
        ("air_draft=0.3", ""),
    ],
)
def test_a_size_that_was_completed_is_told(text: str, said: str) -> None:
    effect, size = parse_effect(text)
    assert completed(effect, text, size) == said
