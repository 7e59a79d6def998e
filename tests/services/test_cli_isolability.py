"""What `drapemeter diagnose --isolability` writes and says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from capture.capture_set import CaptureSet
from diagnosis import isolability
from diagnosis.diagnose import DiagnosisOptions
from diagnosis.isolability import Isolability
from diagnosis.simulation.drape_cache import DrapeCache
from services.cli import diagnose


def test_what_was_assumed_is_written_and_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, shared_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def analyse(*_: Any) -> Isolability:
        return Isolability((), ("hanging",), {}, assumed=("fabric r1: no density",))

    monkeypatch.setattr(isolability, "analyse", analyse)
    captures = CaptureSet.load(shared_dir / "real" / "phisft-r1", read_pictures=False)
    diagnose._isolability(captures, DiagnosisOptions(), DrapeCache(None), tmp_path, json_output=False)
    assert json.loads((tmp_path / diagnose.ISOLABILITY).read_text())["assumed"] == ["fabric r1: no density"]
    assert "assumed: fabric r1: no density" in capsys.readouterr().out
