"""`drapemeter simulate --capture-set`: what the set says, what it refuses, and that it does so before the solve."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture.capture_set import CAPTURES_FILE, CaptureSet
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from services.cli import main
from services.cli.simulate import build_scene
from simcore.parameters import FabricParameters
from simcore.scenes import Setup
from tests.capture.set_document import change, document
from tests.services.test_cli_simulate import FABRIC, command, expect_one_line, parameters

__all__ = ["parameters"]

CLOTH = FabricParameters.from_mapping(FABRIC)


@pytest.fixture
def folder(parameters: Path, tmp_path: Path) -> Path:
    """A set of one capture, and no drape beside it."""
    assert main.run(command(parameters, tmp_path / "a.ply", "--capture-set", str(tmp_path / "set"))) == 0
    (tmp_path / "a.ply").unlink()
    return tmp_path / "set"


@pytest.fixture
def unsolvable(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No further drape is simulated."""

    def solver(*_: Any, **__: Any) -> None:
        raise AssertionError("the drape was simulated")

    monkeypatch.setattr("simcore.solver.Solver", solver)


def test_a_new_set_says_that_its_sensor_is_ideal(parameters: Path, tmp_path: Path) -> None:
    sensor = ["--effect", "range_noise=0.002", "--capture-set", str(tmp_path / "set")]
    assert main.run(command(parameters, tmp_path / "a.ply", *sensor)) == 0
    stated = document(tmp_path / "set")["sensor"]
    assert stated == {"range_noise_m": 0.0, "at_m": 0.9, "quantisation_m": CANONICAL_CAMERA.depth_unit_m}


def test_a_set_with_another_setup_keeps_it(folder: Path, parameters: Path, tmp_path: Path) -> None:
    before = document(folder)
    assert before["setup"]["pin_radius_m"] == 0.01
    other = {"sample_size_m": [0.4, 0.4], "panel": False, "pin_radius_m": 0.0, "camera_from_panel": None}
    change(folder, setup=other)
    arguments = [tmp_path / "a.ply", "--seed", "1", "--capture-set", str(folder), "--fabric", "p"]
    assert main.run(command(parameters, *arguments)) == 0  # type: ignore[arg-type]
    assert document(folder)["setup"] == other
    added = CaptureSet.load(folder).captures[1]
    assert added.setup == Setup.nominal("hanging")
    assert added.camera_from_panel is not None
    np.testing.assert_array_equal(added.camera_from_panel, frontal_pose())
    change(folder, setup=before["setup"])
    assert main.run(command(parameters, *arguments)) == 0  # type: ignore[arg-type]
    assert "setup" not in document(folder)["captures"][2]


def test_a_fabric_with_a_name_of_its_own(parameters: Path, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    for name in ("denim 12/3 (blue)", "../../silk"):
        arguments = command(parameters, tmp_path / "a.ply", "--capture-set", str(folder), "--fabric", name)
        assert main.run(arguments) == 0
    found = CaptureSet.load(folder)
    assert list(found.fabrics) == ["denim 12/3 (blue)", "../../silk"]
    assert all(capture.depth_path.parent == folder for capture in found.captures)


@pytest.mark.usefixtures("unsolvable")
@pytest.mark.parametrize(
    ("keys", "code"),
    [
        ({"fabrics": [{"id": "p", "density": 0.3, "parameters": None}]}, "fabric_differs"),
        ({"sensor": {"range_noise_m": 0.001, "at_m": 0.9}}, "sensor_differs"),
        ({"format": "drape-capture-set/9"}, "capture_format_unknown"),
        ({"fabrics": []}, "capture_set_invalid"),
        ({"setup": {"pins_m": {"hanging": {}}}}, "pins_missing"),
    ],
)
def test_a_set_that_cannot_take_the_capture_is_found_before_the_solve(
    folder: Path, parameters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], keys: dict[str, Any], code: str
) -> None:
    change(folder, **keys)
    refuse(parameters, tmp_path, folder, code, capsys)


def test_other_places_are_refused_before_the_solve(
    parameters: Path, tmp_path: Path, unsolvable: None, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "thesis.txt").write_text("dear")
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / CAPTURES_FILE).write_text("{")
    refuse(parameters, tmp_path, tmp_path / "used", "folder_in_use", capsys)
    refuse(parameters, tmp_path, tmp_path / "damaged", "file_not_json", capsys)
    refuse(parameters, tmp_path, tmp_path / "p.json" / "set", "folder_unusable", capsys)
    refuse(parameters, tmp_path, tmp_path / "new", "fabric_name", capsys, "--fabric", "x" * 201)


def refuse(
    parameters: Path,
    tmp_path: Path,
    folder: Path,
    code: str,
    capsys: pytest.CaptureFixture[str],
    *more: str,
) -> None:
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    outputs = ["--depth", str(tmp_path / "d.png"), "--capture-set", str(folder), "--json"]
    capsys.readouterr()
    assert main.run(command(parameters, tmp_path / "a.ply", *outputs, *more)) == 2
    expect_one_line(capsys, code)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_set_that_changes_meanwhile_leaves_nothing_half_written(
    folder: Path,
    parameters: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    change(folder, fabrics=[{"id": "p", "density": 0.3, "parameters": None}])
    monkeypatch.setattr("services.cli.simulate_files.CapturePlan.check", lambda plan: None)
    refuse(parameters, tmp_path, folder, "fabric_differs", capsys)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_is_a_failure_and_adds_no_capture(
    parameters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second try would otherwise add the same picture again, as a repeat in which nothing scatters."""
    folder, depth = tmp_path / "set", tmp_path / "d.png"
    outputs = ["--depth", str(depth), "--capture-set", str(folder)]
    assert main.run(command(parameters, Path("/dev/full"), *outputs)) == 1
    assert capsys.readouterr().err.endswith("make room, or name another place [cannot_write]\n")
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [parameters]


def test_a_place_without_permission_is_found_before_the_solve(
    parameters: Path, tmp_path: Path, unsolvable: None, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: mode == os.R_OK)
    assert main.run(command(parameters, tmp_path / "a.ply")) == 2
    expect_one_line(capsys, "cannot_write")


def test_processes_that_add_at_once_lose_nothing(parameters: Path, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    program = "import sys\nfrom services.cli import main\nsys.exit(main.run(sys.argv[1:]))\n"
    running = []
    for n in range(2):
        own = ["--seed", str(n), "--capture-set", str(folder), "--fabric", f"f{n}"]
        arguments = command(parameters, tmp_path / f"{n}.ply", *own)
        running.append(subprocess.Popen([sys.executable, "-c", program, *arguments]))
    assert [process.wait() for process in running] == [0, 0]
    assert sorted(CaptureSet.load(folder).fabrics) == ["f0", "f1"]


def fields(text: str, *, scene: str = "hanging", cloth: FabricParameters = CLOTH, seed: int = 0) -> tuple[Any, ...]:
    _, changed = build_scene(scene, [text], cloth, seed, pictured=False)
    return changed.mechanics.rest_curvature


def test_an_effect_that_differs_from_repeat_to_repeat_follows_the_seed() -> None:
    softer = FabricParameters.from_mapping({**FABRIC, "bending_warp": 2e-5})
    text = "bending_hysteresis=10"
    assert fields(text) == fields(text)
    assert fields(text)[0].amplitude == 10.0
    drawn = [fields(text), fields(text, seed=1), fields(text, scene="stretch"), fields(text, cloth=softer)]
    assert len({found[0].seed for found in drawn}) == 4
    for seed in (0, 1):
        assert fields("bending_hysteresis=magnitude:10,seed:7", seed=seed)[0].seed == 7
    assert fields("bending_hysteresis=magnitude:10", seed=1) == drawn[1]
