"""A place that cannot take the result is found before the work, with exit status 2."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from diagnosis.blind.make import MANIFEST_FILE, plan_of
from diagnosis.extension import SimulatorExtension
from services.cli import diagnose, main
from services.cli.outputs import check_file, check_folder
from simcore.errors import InputError
from tests.services.command_inputs import make_inputs

WORK = (
    "simcore.solver.Solver",
    "diagnosis.diagnose.diagnose",
    "diagnosis.isolability.analyse",
    "diagnosis.atlas.build_atlas",
    "diagnosis.blind.make.make_blind_check",
    "diagnosis.blind.answers.answer_cases",
    "capture.prepare.prepare_all",
    "capture.sources.PngFolderSource.frames",
    "services.cli.train.run",
    "services.web.study_pictures.entries_from_library",
    "services.dataset.inspection.inspect_store",
    "metric.search.search_library",
)
PARAMETERS = ["--scene", "hanging", "--parameters", "p.json"]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with what commands read, a file and folders in the way; any work fails the test."""

    def work(*_: Any, **__: Any) -> None:
        raise AssertionError("the work began")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DRAPEMETER_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("DRAPEMETER_DATABASE", f"sqlite:///{tmp_path / 'd.db'}")
    (tmp_path / "file").write_text("in the way")
    for name in ("in.md", "in.csv", "in.png", "taken/report.json"):
        (tmp_path / name).mkdir(parents=True)
    make_inputs(tmp_path)
    for name in WORK:
        monkeypatch.setattr(name, work)
    return tmp_path


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("diagnose set --out file/report", "folder_unusable"),
        ("diagnose set --out file/report --isolability", "folder_unusable"),
        ("diagnose set --out file/report --build-atlas", "folder_unusable"),
        ("diagnose set --out file", "output_is_file"),
        ("diagnose set --out report --atlas file/atlas --build-atlas", "folder_unusable"),
        ("diagnose set --out taken", "output_is_folder"),
        ("diagnose set --out report --isolability --build-atlas", "options_exclude"),
        ("diagnose set --out report --isolability --apply", "options_exclude"),
        ("diagnose set --out report --address auto", "address"),
        ("diagnose set --out report --workers 0", "workers"),
        ("diagnose set --out report --resolution 0", "resolution_out_of_range"),
        ("diagnose set --out report --resolution nan --isolability", "resolution_out_of_range"),
        ("blind make 1 new --resolution 0.013", "resolution_does_not_divide"),
        ("blind make 1 new --scenes hanging,hanging --plan-only", "blind_plan"),
        ("blind make 1 file/check", "folder_unusable"),
        ("blind make 1 new --withhold crease,wind --plan-only", "effect_unknown"),
        ("blind score check --page file/page.md", "folder_unusable"),
        ("blind score check --page in.md", "output_is_folder"),
        ("blind score check --train set", "blind_train"),
        ("capture register set --out file/registered", "folder_unusable"),
        ("capture import frames --camera camera.json --fabric a --scene hanging --out file/set", "folder_unusable"),
        ("capture import frames --camera camera.json --fabric a --scene hanging --out frames", "folder_in_use"),
        ("capture record --fabric a --scene hanging --out file/set", "folder_unusable"),
        ("train --store s.zarr --out file/model", "folder_missing"),
        ("train --store s.zarr --out model --tensorboard file/events", "folder_unusable"),
        ("rank p.json library.json --figure in.png", "output_is_folder"),
        ("rank p.json library.json --figure new/search.docx", "figure_form"),
        ("rank p.json library.json --figure new/search", "figure_form"),
        ("rank p.json library.json --top -1", "top_out_of_range"),
        ("study export study_0 --out in.csv", "output_is_folder"),
        ("study export study_0 --out answers.xlsx", "export_form"),
        ("study compare --backends , --out new", "backends_missing"),
        ("study make library.json --shared 30", "triplets_shared"),
        ("study make library.json", "fabrics_too_few"),
        ("study make --photographs frames", "study_empty"),
        ("dataset inspect s.zarr --figures file/figures", "folder_unusable"),
    ],
)
def test_bad_places_are_found_before_the_work(
    place: Path, command: str, code: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(place.rglob("*"))
    assert main.run([*command.split(), "--json"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert captured.err.endswith(f"[{code}]\n")
    assert sorted(place.rglob("*")) == before


def test_a_cache_that_cannot_be_is_found_before_the_diagnosis(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DRAPEMETER_CACHE", str(place / "file"))
    for command in ("diagnose set --out report", "blind score check"):
        assert main.run(command.split()) == 2
        error = capsys.readouterr().err
        assert "DRAPEMETER_CACHE" in error and "[folder_unusable]" in error


def test_an_atlas_that_would_be_kept_nowhere_is_not_built(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DRAPEMETER_CACHE", "")
    before = sorted(place.rglob("*"))
    assert main.run(["diagnose", "set", "--out", "report", "--build-atlas"]) == 2
    said = capsys.readouterr().err
    assert "nothing would be kept: give --atlas" in said and said.endswith("[atlas_missing]\n")
    assert sorted(place.rglob("*")) == before


@pytest.mark.parametrize("target", ["file", "file/inner/deep", "broken", "broken/inner"])
def test_folders_that_cannot_be_made(place: Path, target: str) -> None:
    (place / "broken").symlink_to(place / "nowhere")
    with pytest.raises(InputError, match="name another"):
        check_folder(Path(target), "name another")
    with pytest.raises(InputError, match="name a"):
        check_file(Path(target) / "page.md")


def test_folders_that_can_be_made_are_not_made(place: Path) -> None:
    check_folder(Path("new/inner"), "name another")
    check_file(Path("new/inner/page.md"))
    check_folder(Path(), "name another")
    assert not (place / "new").exists()


def test_a_folder_without_permission(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(InputError, match="cannot be written to"):
        check_folder(place / "new", "name another")


def test_a_simulator_file_that_no_report_wrote_is_not_taken_for_an_earlier_ones(tmp_path: Path) -> None:
    path = tmp_path / "simulator.json"
    assert not diagnose._is_own(path)
    path.write_text('{"mine": 1}')
    assert not diagnose._is_own(path)
    with pytest.raises(InputError) as caught:
        diagnose._check_out(tmp_path, apply=True)
    assert caught.value.code == "output_in_use"
    diagnose._check_out(tmp_path, apply=False)
    SimulatorExtension(effects=()).save(path)
    assert diagnose._is_own(path)
    path.write_text('{"format": "drapemeter-simulator/1", "effects": [{"name": "gone", "size": {"magnitude": 1}}]}')
    assert diagnose._is_own(path)  # an own effect that was taken out of the catalogue since
    diagnose._check_out(tmp_path, apply=True)


@pytest.mark.parametrize("workers", ["0", "-3"])
def test_a_check_needs_a_worker(workers: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["blind", "score", str(tmp_path), "--workers", workers]) == 2
    assert capsys.readouterr().err.strip().endswith("[workers]")


def test_names_of_scenes_may_have_blanks(tmp_path: Path) -> None:
    plan = ["blind", "make", "2", str(tmp_path / "check"), "--scenes", "hanging, stretch,", "--plan-only"]
    assert main.run(plan) == 0
    manifest = json.loads((tmp_path / "check" / MANIFEST_FILE).read_text())
    assert plan_of(manifest).scenes == ("hanging", "stretch")
