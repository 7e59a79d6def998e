"""`drapemeter simulate`: the contract's document, same seed same bits, one clear line for each bad input."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from services.cli import main

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
        (["--seed", "-1"], "seed_negative"),
        (["--seed", "one"], "usage"),
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
    monkeypatch.chdir(tmp_path)
    assert main.run([*command(parameters, Path("a.ply")), *arguments]) == 2
    expect_one_line(capsys, code)
    assert list(tmp_path.iterdir()) == [parameters]


def expect_one_line(capsys: pytest.CaptureFixture[str], code: str) -> None:
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.endswith(f"[{code}]\n")
    assert captured.err.count("\n") == 1
