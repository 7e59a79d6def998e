"""A fabric that is simulated stiffer than stated is named by all that simulates it: notes, documents, jobs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metric.draping import DrapeRequest, RequestResult
from metric.render import DrapeRender
from services.caches import metric_caches
from services.cli.main import run
from services.jobs.execute import execute
from services.jobs.task import Resources, Task

STATED = {
    "stretch_warp": 1000.0,
    "stretch_weft": 800.0,
    "stretch_bias": 300.0,
    "bending_warp": 5e-4,
    "bending_weft": 4e-4,
    "bending_bias": 4e-4,
    "density": 0.2,
}
RAISED = {**STATED, "bending_weft": 1e-5, "bending_bias": 1e-6}
SAID = "has a bending_bias of 1e-06 N·m; simulated with"
SMALL = ["--simulations", "2", "--resolution", "0.025", "--workers", "1"]


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Folds by density stand for simulations; nothing is kept, and the database is the test's own."""

    def drape(request: DrapeRequest) -> RequestResult:
        _, x = np.mgrid[0:64, 0:64] / 63.0
        height = 0.02 * (
            1 + np.cos(20 * request.fabric.density * (x + 0.1 * request.repeat) + request.fabric.bending_weft)
        )
        shaded, depth = (60 + 2000 * height).astype(np.uint8), (0.9 - height).astype(np.float32)
        return RequestResult(request, DrapeRender(shaded, depth))

    monkeypatch.setattr("metric.simulate.run_request", drape)
    monkeypatch.setattr("services.caches.shared_metric_caches", lambda: metric_caches(None))
    monkeypatch.setenv("DRAPEMETER_CACHE", "")
    monkeypatch.setenv("DRAPEMETER_DATABASE", f"sqlite:///{tmp_path / 'd.db'}")


def written(path: Path, content: object) -> str:
    path.write_text(json.dumps(content))
    return str(path)


def library(path: Path, raised: str) -> str:
    """Four fabrics, ``a`` to ``d``, of which one has a ``bending_bias`` that no plate has."""
    rows = [
        {**(RAISED if name == raised else STATED), "id": name, "density": 0.1 + 0.1 * k}
        for k, name in enumerate("abcd")
    ]
    return written(path, rows)


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[dict[str, Any], str]:
    """A command's document and its notes."""
    assert run([*arguments, "--json"]) == 0
    captured = capsys.readouterr()
    return json.loads(captured.out), captured.err


def test_distances_and_rankings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stated, raised = written(tmp_path / "s.json", STATED), written(tmp_path / "r.json", RAISED)
    quick = ["--backend", "depth", *SMALL]
    found, notes = said(capsys, "distance", stated, raised, *quick)
    assert list(found["raised_bias"]) == [raised] and SAID in found["raised_bias"][raised]
    assert f"{raised}: {found['raised_bias'][raised]}\n" in notes
    assert said(capsys, "distance", stated, stated, *quick)[0]["raised_bias"] == {}
    ranked, notes = said(capsys, "rank", raised, library(tmp_path / "l.json", "c"), "--top", "1", *quick)
    assert list(ranked["raised_bias"]) == [raised, "c"] and notes.count(SAID) == 2
    assert said(capsys, "rank", stated, library(tmp_path / "l.json", "none"), *quick)[0]["raised_bias"] == {}


def test_many_fabrics_are_all_in_the_document_and_some_in_the_notes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = written(tmp_path / "many.json", [{**RAISED, "id": f"f{k}", "density": 0.1 + 0.01 * k} for k in range(8)])
    reference = written(tmp_path / "s.json", STATED)
    found, notes = said(capsys, "rank", reference, rows, "--backend", "depth", *SMALL)
    assert list(found["raised_bias"]) == [f"f{k}" for k in range(8)]
    assert notes.count(SAID) == 5 and "the same goes for 3 more fabrics" in notes


def test_studies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made, notes = said(capsys, "study", "make", library(tmp_path / "l.json", "b"), "--triplets", "8", *SMALL)
    assert f"b: no plate with its bending_warp and bending_weft {SAID}" in notes and notes.count(SAID) == 1
    study = made["study"]
    said(capsys, "study", "simulate", study, "--observers", "2")
    analyse = ["study", "analyse", study, "--simulated", "--bootstrap", "0", *SMALL]
    found, notes = said(capsys, *analyse, "--backends", "depth", "--out", str(tmp_path / "out"))
    assert list(found["raised_bias"]) == ["b"] and notes.count(SAID) == 1
    assert json.loads((tmp_path / "out" / "analysis.json").read_text()) == found
    other = library(tmp_path / "other.json", "d")
    found, notes = said(capsys, *analyse, "--backends", "depth", "--library", other)
    assert list(found["raised_bias"]) == ["d"] and f"d: {found['raised_bias']['d']}\n" in notes
    found, notes = said(capsys, *analyse, "--backends", "", "--library", other)  # nothing is simulated
    assert found["raised_bias"] == {} and SAID not in notes


def result(kind: str, folder: Path, inputs: dict[str, Any]) -> dict[str, Any]:
    """What a job of two simulations on coarse cells leaves."""
    quick = {"simulations": 2, "backend": "depth", "resolution_m": 0.025}
    task = Task("job_1", kind, {**quick, **inputs}, (), Resources(), folder)
    return execute(task, report=lambda _fraction, _message="": None).result


def test_a_job_of_two_fabrics(tmp_path: Path) -> None:
    found = result("drape_distance", tmp_path, {"a": STATED, "b": RAISED})["raised_bias"]
    assert list(found) == ["b"] and SAID in found["b"]
    assert result("drape_distance", tmp_path, {"a": STATED, "b": STATED})["raised_bias"] == {}


def test_a_job_that_searches(tmp_path: Path) -> None:
    rows = [
        {"id": f"fab_{k}", "name": f"of {k}", "plm_ref": None, "parameters": {**values, "density": 0.1 + 0.1 * k}}
        for k, values in enumerate([STATED, RAISED, STATED])
    ]
    found = result("fabric_search", tmp_path, {"library": rows, "reference": RAISED, "limit": 1})
    assert len(found["ranking"]) == 1 and list(found["raised_bias"]) == ["reference", "fab_1"]
    found = result("fabric_search", tmp_path, {"library": rows, "fabric_id": "fab_1"})
    assert list(found["raised_bias"]) == ["fab_1"] and SAID in found["raised_bias"]["fab_1"]
    found = result("fabric_search", tmp_path, {"library": rows[::2], "reference": STATED})
    assert found["raised_bias"] == {}
