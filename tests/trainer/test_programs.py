"""The side programs `python -m trainer...` find out what cannot be before they train for hours."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import pytest

from simcore.errors import InputError
from tests.services.dataset_helpers import small_sweep
from tests.services.dataset_rows import made_up_store
from trainer import ablation, program


def test_an_ablation_needs_both_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = made_up_store(tmp_path / "h.zarr", *small_sweep(materials=3, scenes=("hanging",)))
    monkeypatch.setattr(ablation, "run", lambda *given: pytest.fail("it began to train"))
    options = Namespace(store=str(store), out=tmp_path / "out", preset="quick", epochs=1, seed=0, pretrained=False)
    with pytest.raises(InputError, match="lacks usable pictures of stretch"):
        ablation._run(options)


def test_a_file_in_the_place_of_results_is_told_beforehand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(SystemExit) as ended, program.told_in_one_line():
        program.make_results_folder(tmp_path / "out")
    assert ended.value.code == 2
    assert capsys.readouterr().err.strip().endswith("[folder_unusable]")
    assert (tmp_path / "out").read_text() == "mine"
