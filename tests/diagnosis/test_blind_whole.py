"""A whole blind check, small: made, diagnosed without its label, opened, verified, written down."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from diagnosis.blind.answers import REPORTS_FOLDER
from diagnosis.blind.make import BlindPlan, draw_kinds, draw_label
from diagnosis.effects import catalogue
from services.cli import main

KNOWN = ("depth_scale", "panel_tilt")
WITHHELD = tuple(name for name in catalogue() if name not in KNOWN)
SEED = next(
    seed
    for seed in range(1000)
    if draw_kinds(plan := BlindPlan(1, seed, fabrics=2, repeats=2, pool=2, withhold=WITHHELD, scenes=("stretch",)))
    == ["named"]
    and draw_label(0, plan).effects[0][0].name == "depth_scale"
)


@pytest.mark.slow
def test_a_check_from_its_plan_to_its_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DRAPEMETER_CACHE", str(tmp_path / "cache"))
    check, page = tmp_path / "check", tmp_path / "page.md"
    sizes = ["--fabrics", "2", "--repeats", "2", "--pool", "2", "--scenes", "stretch", "--seed", str(SEED)]
    left_out = [word for name in WITHHELD for word in ("--withhold", name)]
    assert main.run(["blind", "make", "1", str(check), *sizes, *left_out, "--plan-only"]) == 0
    assert not (check / "case-001").exists()
    capsys.readouterr()
    assert main.run(["blind", "score", str(check), "--make", "--page", str(page), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["cases"] == 1
    report = json.loads((check / REPORTS_FOLDER / "case-001.json").read_text())
    assert report["cause"]["top"] == "depth_scale" and report["pin_radius_m"] is None
    assert found["probability_of_truth"] > 0.8
    assert found["shrinkage_relative"] > 0.8  # of further captures, which no diagnosis has seen
    text = page.read_text()
    assert "1 of 1 sealed cases" in text and "depth_scale | depth_scale" in text and "panel_friction" in text
    before = (check / REPORTS_FOLDER / "case-001.json").read_bytes()
    assert main.run(["blind", "score", str(check)]) == 0  # what is answered stays answered
    assert (check / REPORTS_FOLDER / "case-001.json").read_bytes() == before
