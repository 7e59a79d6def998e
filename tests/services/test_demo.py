"""The demonstration: a tiny one leaves everything its page shows; folders of others are left alone."""

from __future__ import annotations

import json
import re
from pathlib import Path
from unittest.mock import Mock

import pytest

from diagnosis.atlas import open_atlas
from services.cli import main
from services.demo.learning import learn
from services.demo.plan import DemoPlan
from services.demo.steps import MARKER, _is_ours, prepare_folder
from simcore.errors import InputError
from tests.services.analytic_store import make_store
from trainer.store_source import StoreSource

TINY = DemoPlan(fine_m=0.05, coarse_m=0.05, materials=10, epochs=1, simulations=2, repeats=2)


@pytest.mark.slow
@pytest.mark.ray
@pytest.mark.timeout(600)
def test_a_tiny_demonstration_leaves_what_its_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("services.demo.plan.DemoPlan", lambda seed: TINY)
    monkeypatch.setenv("DRAPEMETER_WEIGHTS", str(tmp_path / "nowhere"))
    out = tmp_path / "demo-out"
    assert main.run(["demo", "--out", str(out), "--json"]) == 0
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert len(document["estimates"]) == 4 * 6
    assert document["distances"]["backend"] == "depth"
    assert "DRAPEMETER_WEIGHTS" in document["distances"]["notice"]
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "stands in" in page
    made = re.search(r"made an atlas first, (\d+) simulations", page)
    assert made and int(made[1]) > 100
    assert open_atlas(out / "atlas").files()
    shown = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert {"sweep.png", "distances.png", "report/report.html", "hanging-depth.png", "stretch-shaded.png"} <= set(shown)
    for name in shown:
        assert (out / name).stat().st_size > 0, name
    assert json.loads((out / MARKER).read_text(encoding="utf-8"))["samples"] == document["samples"]
    assert _is_ours(out / MARKER)  # a second one may take its place
    assert not [line for line in captured.err.splitlines() if line.startswith("error")]


def test_the_demonstrations_model_knows_the_store_it_learnt_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By it an estimate knows how magnets held what was learnt from."""
    store, told = make_store(tmp_path / "store.zarr"), []
    monkeypatch.setattr("services.demo.learning.train", lambda _source, _config, **said: told.append(said) or Mock())
    learn(store, tmp_path / "model", epochs=1, seed=0)
    assert told[0]["provenance"] == StoreSource(store).provenance()
    assert told[0]["provenance"]["configuration"] == {"made": "by hand"}


def test_an_earlier_demonstration_is_replaced_and_other_folders_are_not(tmp_path: Path) -> None:
    out = tmp_path / "out"
    prepare_folder(out)
    (out / "old.png").write_bytes(b"x")
    prepare_folder(out)
    assert [path.name for path in out.iterdir()] == [MARKER]

    (tmp_path / "link").symlink_to(out)
    others = tmp_path / "others"
    others.mkdir()
    for content in ('{"name": "my own settings"}', "{}", "no JSON"):
        (others / MARKER).write_text(content, encoding="utf-8")
        with pytest.raises(InputError, match="holds no earlier demonstration"):
            prepare_folder(others)
        assert (others / MARKER).read_text(encoding="utf-8") == content
    (out / "report").mkdir()
    prepare_folder(tmp_path / "link")
    assert (tmp_path / "link").is_symlink() and [path.name for path in out.iterdir()] == [MARKER]

    other = tmp_path / "thesis"
    other.mkdir()
    (other / "chapter.tex").write_text("mine")
    with pytest.raises(InputError, match=r"not empty .*: give --out another folder") as caught:
        prepare_folder(other)
    assert caught.value.code == "folder_not_empty"
    with pytest.raises(InputError, match="cannot make") as caught:
        prepare_folder(other / "chapter.tex" / "out")
    assert caught.value.code == "cannot_write"
    assert [path.name for path in other.iterdir()] == ["chapter.tex"]
    assert (other / "chapter.tex").read_text() == "mine"
