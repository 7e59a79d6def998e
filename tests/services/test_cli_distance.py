"""`drapemeter distance` and `drapemeter rank`: documents, exit codes, messages."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from metric.draping import DrapeRequest, RequestResult
from metric.render import DrapeRender
from metric.search import RankedFabric, SearchResult
from services.cli.main import run
from simcore.scenes import Scene

VALUES = {
    "stretch_warp": 1000.0,
    "stretch_weft": 800.0,
    "stretch_bias": 300.0,
    "bending_warp": 5e-4,
    "bending_weft": 4e-4,
    "bending_bias": 4e-4,
    "density": 0.2,
}
QUICK = ["--backend", "depth", "--simulations", "2", "--resolution", "0.025", "--workers", "1"]


@pytest.fixture
def fabrics(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str, str]:
    """Two fabrics and a library of both; a cache folder of their own."""
    monkeypatch.setenv("DRAPEMETER_CACHE", str(tmp_path / "cache"))
    softer = {**VALUES, "bending_warp": 1e-4, "bending_weft": 1e-4, "bending_bias": 1e-4}
    paths = []
    for name, document in (
        ("a.json", VALUES),
        ("b.json", softer),
        ("library.json", [{"id": "stiff", **VALUES}, {"id": "softer", **softer}]),
    ):
        (tmp_path / name).write_text(json.dumps(document))
        paths.append(str(tmp_path / name))
    return paths[0], paths[1], paths[2]


def test_distance_and_rank_as_json(
    fabrics: tuple[str, str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b, library = fabrics
    assert run(["distance", a, b, *QUICK, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["distance"] == pytest.approx(sum(found["scenes"].values()) / 2)
    assert set(found["scenes"]) == {"hanging", "stretch"}
    assert found["simulations"] == 2
    assert found["standard_error"] > 0
    assert (found["backend"], found["unit"], found["seed"], found["retries"]) == ("depth", "m", 0, [])

    thumbnails, figure = tmp_path / "thumbnails", tmp_path / "search.png"
    extra = ["--thumbnails", str(thumbnails), "--figure", str(figure)]
    assert run(["rank", a, library, *QUICK, *extra, "--json"]) == 0
    ranking = json.loads(capsys.readouterr().out)["ranking"]
    assert [r["id"] for r in ranking] == ["stiff", "softer"]
    assert ranking[1]["distance"] == pytest.approx(found["distance"])
    assert all(Path(p).stat().st_size > 100 for r in ranking for p in r["thumbnails"].values())
    assert figure.stat().st_size > 1000

    assert run(["rank", a, library, *QUICK, "--top", "1"]) == 0
    out = capsys.readouterr().out
    assert "stiff" in out
    assert "softer" not in out


def test_what_was_simulated_again_says_of_which_fabric(
    fabrics: tuple[str, str, str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b, _ = fabrics

    def second_attempt(request: DrapeRequest) -> RequestResult:
        again = request.scene == "stretch" and request.fabric.bending_warp == 1e-4
        picture = np.full((64, 64), 0.5, np.float32)
        return RequestResult(request, DrapeRender(None, picture), ("time limit",) if again else ())

    monkeypatch.setattr("metric.simulate.run_request", second_attempt)
    assert run(["distance", a, b, *QUICK, "--no-cache", "--json"]) == 0
    said = capsys.readouterr()
    assert f"B ({b}): stretch 1 was simulated again: time limit\n" in said.err and "A (" not in said.err
    assert json.loads(said.out)["retries"] == [
        {"fabric": "B", "scene": "stretch", "repeat": repeat, "reasons": ["time limit"]} for repeat in range(2)
    ]


@pytest.mark.parametrize(("top", "shown"), [([], 6), (["--top", "2"], 2), (["--top", "9"], 9), (["--top", "14"], 12)])
def test_the_figure_shows_as_many_as_are_ranked(
    top: list[str], shown: int, fabrics: tuple[str, str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = tmp_path / "many.json"
    library.write_text(json.dumps([{"id": f"f{k}", **VALUES, "density": 0.1 + 0.01 * k} for k in range(15)]))
    picture = dict.fromkeys(Scene, np.zeros((8, 8), np.uint8))
    ranking = [RankedFabric(f"f{k}", float(k), None, picture) for k in range(15)]
    monkeypatch.setattr("metric.search.search_library", lambda *_, **__: SearchResult(ranking, picture))
    figure = tmp_path / "search.svg"
    drawn: list[str] = []
    monkeypatch.setattr("metric.figures._show", lambda _axes, _pictures, title: drawn.append(title))
    assert run(["rank", fabrics[0], str(library), *QUICK, *top, "--figure", str(figure)]) == 0
    names = [title.split("\n")[0] for title in drawn]
    assert names[0] == names[shown + 1] == "reference" and len(names) == 2 * (shown + 1)
    assert names[1 : shown + 1] == [f"f{k}" for k in range(shown)] and figure.stat().st_size > 100


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--simulations", "0"], "simulations must be"),
        (["--backend", "ssimm"], "unknown back end"),
        (["--resolution", "0.03"], "does not divide"),
        (["--seed", "-1"], "seed"),
    ],
)
def test_bad_options(
    fabrics: tuple[str, str, str], arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["distance", fabrics[0], fabrics[1], "--backend", "depth", *arguments]) == 2
    assert run(["rank", fabrics[0], fabrics[2], "--backend", "depth", *arguments]) == 2
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert len(lines) == 2
    assert all(message in line for line in lines)
    assert captured.out == ""


def test_bad_files(fabrics: tuple[str, str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.json").write_text(json.dumps({**VALUES, "density": -0.2}))
    (tmp_path / "empty.json").write_text("[]")
    before = sorted(tmp_path.iterdir())
    a, _, library = fabrics
    for arguments, told, code in (
        (["distance", a, str(tmp_path / "bad.json")], "density", "parameter_out_of_range"),
        (["distance", a, str(tmp_path / "none.json")], "no such file", "file_missing"),
        (["rank", a, str(tmp_path / "empty.json")], "holds no fabrics", "library_empty"),
        (["rank", a, library, "--top", "-1"], "got -1: give 0 for all", "top_out_of_range"),
        (["rank", a, library, "--figure", str(tmp_path / "s.docx")], "name a .png, .pdf or .svg file", "figure_form"),
        (["rank", a, library, "--thumbnails", str(tmp_path / "bad.json")], "cannot be made", "folder_unusable"),
    ):
        assert run(arguments) == 2
        said = capsys.readouterr().err
        assert told in said and said.endswith(f"[{code}]\n") and said.count("\n") == 1
        assert sorted(tmp_path.iterdir()) == before


def test_a_cache_folder_that_cannot_be_made(
    fabrics: tuple[str, str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DRAPEMETER_CACHE", str(tmp_path / "file" / "cache"))
    assert run(["distance", fabrics[0], fabrics[1], "--backend", "depth"]) == 2
    assert "set DRAPEMETER_CACHE to another folder, or give --no-cache" in capsys.readouterr().err


def test_missing_weights_exit_1_and_name_the_way_out(
    fabrics: tuple[str, str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import urllib.error

    import torch

    def no_internet(*_: object, **__: object) -> None:
        raise urllib.error.URLError("Name or service not known")

    monkeypatch.setattr(torch.hub, "download_url_to_file", no_internet)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    monkeypatch.setenv("DRAPEMETER_WEIGHTS", str(tmp_path))
    assert run(["distance", fabrics[0], fabrics[1]]) == 1
    assert "--backend depth" in capsys.readouterr().err


def test_a_ranking_that_cannot_be_leaves_nothing(fabrics: tuple[str, str, str], tmp_path: Path) -> None:
    a, _, library = fabrics
    before = sorted(tmp_path.iterdir())
    places = ["--thumbnails", str(tmp_path / "th"), "--figure", str(tmp_path / "fig" / "s.png")]
    assert run(["rank", a, library, "--backend", "nonsense", *places]) == 2
    assert sorted(tmp_path.iterdir()) == before
