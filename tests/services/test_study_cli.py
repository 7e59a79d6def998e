"""`drapemeter study` from photographs to analysis, and the comparison of image distances."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from metric.agreement import rank_correlations
from metric.draping import DrapeRequest, RequestResult
from metric.library import LibraryFabric
from metric.orderings import default_sweeps
from metric.render import DrapeRender
from metric.simulate import SimulationPlan, samples_apart
from services.cli.main import run
from services.web.study_pictures import entries_from_library
from simcore.errors import SimulationError
from simcore.parameters import FabricParameters
from simcore.prior import FabricPrior
from simcore.scenes import Scene

OTHER_CACHE = "set DRAPEMETER_CACHE to another folder, or to nothing at all to keep nothing [folder_unusable]"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a library and photographs of eight fabrics; database and caches of their own."""
    monkeypatch.setenv("DRAPEMETER_DATABASE", f"sqlite:///{tmp_path / 'd.db'}")
    monkeypatch.setenv("DRAPEMETER_CACHE", str(tmp_path / "cache"))
    fabrics = FabricPrior.default().sample(range(8), seed=0)
    library = [{"id": f"fabric-{k}", **f.as_dict()} for k, f in enumerate(fabrics)]
    (tmp_path / "library.json").write_text(json.dumps(library))
    rng = np.random.default_rng(0)
    for k in range(8):
        inner = tmp_path / "photos" / f"fabric-{k}"
        inner.mkdir(parents=True)
        exif = Image.Exif()
        exif[0x010F] = "a camera"
        for name in ("front.jpg", "side.png"):
            pixels = rng.integers(0, 255, (1200, 900, 3), dtype=np.uint8)
            Image.fromarray(pixels).save(inner / name, exif=exif)
    return tmp_path


def document(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert run([*arguments, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_a_study_with_photographs_and_simulated_observers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos = ["--photographs", str(folder / "photos")]
    made = document(capsys, "study", "make", str(folder / "library.json"), *photos, "--name", "pilot")
    study = made["study"]
    assert (made["fabrics"], made["triplets"], made["shared"]) == (8, 20, 5)

    assert run(["study", "analyse", study]) == 2
    assert "no answers of people yet [answers_missing]" in capsys.readouterr().err

    few, truth = (
        document(capsys, "study", "simulate", study, "--observers", n, "--noise", "0.1", "--seed", s)["points"]
        for n, s in (("5", "0"), ("15", "3"))
    )
    assert few == truth  # all observers of a study judge by one plane
    listed = document(capsys, "study", "list")["studies"]
    assert [(s["id"], s["participants"], s["simulated_observers"]) for s in listed] == [(study, 0, 20)]

    out = folder / "analysis"
    found = document(
        capsys, "study", "analyse", study, "--simulated", "--backends", "", "--bootstrap", "20", "--out", str(out)
    )
    assert found["observers"] == "simulated"
    assert (found["participants"], found["answers"]) == (20, 400)
    assert found["agreement"]["questions"] >= 5
    assert found["agreement"]["share"] > 0.8
    points = (np.array(truth), np.array(found["embedding"]["points"]))
    distances = [np.linalg.norm(p[:, None] - p[None], axis=2) for p in points]
    assert np.mean(rank_correlations(*distances)) > 0.85
    assert set(found["metrics"]) == {"parameters", "parameters_values"}
    assert found["settings"] == {
        "seed": 0, "bootstrap": 20, "simulations": 5, "resolution": 0.01, "library": None,
    }  # fmt: skip
    given = document(capsys, "study", "analyse", study, "--simulated", "--backends", "", "--bootstrap", "0",
                     "--library", str(other_parameters(folder)))  # fmt: skip
    assert given["metrics"]["parameters"]["mean"] != found["metrics"]["parameters"]["mean"]
    low, high = found["metrics"]["parameters"]["interval_95"]
    assert -1 <= low < high <= 1
    assert (out / "embedding.png").stat().st_size > 1000
    assert json.loads((out / "analysis.json").read_text()) == found

    exported = folder / "answers.csv"
    assert document(capsys, "study", "export", study, "--out", str(exported))["answers"] == 400
    rows = list(csv.DictReader(exported.open()))
    assert len(rows) == 400
    assert {int(r["participant"]) for r in rows} == set(range(20))  # by number: the identifiers open their answers
    assert {r["simulated"] for r in rows} == {"True"}
    assert {r["reference"] for r in rows} == {f"fabric-{k}" for k in range(8)}


def test_simulated_observers_of_a_seed_always_choose_the_same(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos = ["--photographs", str(folder / "photos"), "--triplets", "16"]
    study = document(capsys, "study", "make", str(folder / "library.json"), *photos)["study"]
    document(capsys, "study", "simulate", study, "--observers", "2")
    document(capsys, "study", "simulate", study, "--observers", "1", "--noise", "0", "--seed", "3")
    exported = folder / "answers.csv"
    document(capsys, "study", "export", study, "--out", str(exported))
    chosen = ["", "", ""]
    for row in csv.DictReader(exported.open()):
        chosen[int(row["participant"])] += row["chosen"].removeprefix("fabric-")
    assert chosen == ["4164255701716451", "0010776567026644", "7640062670506426"]


def other_parameters(folder: Path) -> Path:
    """The study's fabrics with the parameters of others."""
    path = folder / "estimated.json"
    fabrics = FabricPrior.default().sample(range(8, 16), seed=0)
    path.write_text(json.dumps([{"id": f"fabric-{k}", **fabric.as_dict()} for k, fabric in enumerate(fabrics)]))
    return path


def test_photographs_are_scaled_and_stripped(folder: Path) -> None:
    import io

    from services.web.study_pictures import entries_from_photographs

    entries = entries_from_photographs(folder / "photos")
    assert [e.name for e in entries] == [f"fabric-{k}" for k in range(8)]
    assert all(e.parameters is None and len(e.pictures) == 2 for e in entries)
    for shown in entries[0].pictures:
        with Image.open(io.BytesIO(shown.content)) as image:
            assert max(image.size) == 1024
            assert len(image.getexif()) == 0


def test_photographs_that_the_library_does_not_name_are_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "photos" / "fabric-3").rename(folder / "photos" / "Fabric-3")
    library, photos = str(folder / "library.json"), str(folder / "photos")
    assert run(["study", "make", library, "--photographs", photos]) == 2
    said = capsys.readouterr().err
    assert "no fabric named Fabric-3 (it has fabric-0, " in said and said.endswith("[photographs_unknown]\n")
    assert not (folder / "d.db").exists()
    (folder / "photos" / "Fabric-3").rename(folder / "Fabric-3")
    assert run(["study", "make", library, "--photographs", photos]) == 0
    assert "no photographs of fabric-3: the study is without them" in capsys.readouterr().err
    (folder / "Fabric-3").rename(folder / "photos" / "Fabric-3")
    study = document(capsys, "study", "make", "--photographs", photos)["study"]
    document(capsys, "study", "simulate", study, "--observers", "1")
    assert run(["study", "analyse", study, "--simulated", "--backends", "nothing"]) == 2
    capsys.readouterr()
    analysed = run(["study", "analyse", study, "--simulated"])  # LPIPS, which nothing is asked of
    said = capsys.readouterr().err
    assert analysed == 0
    assert "parameters are unknown of" in said and "Fabric-3" in said and "20 answers place 8 fabrics poorly" in said


def test_what_is_refused_leaves_nothing_behind(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(folder.iterdir())
    for arguments in (
        ["analyse", "study_x", "--out", str(folder / "new")],
        ["export", "study_x", "--out", str(folder / "new" / "x.csv")],
        ["list"],
    ):
        assert run(["study", *arguments]) == 2
        assert "no such database" in capsys.readouterr().err
        assert sorted(folder.iterdir()) == before
    made = document(capsys, "study", "make", "--photographs", str(folder / "photos"))
    for arguments, code in (
        (["analyse", "study_x"], "study_unknown"),
        (["analyse", made["study"], "--backends", "nosuch"], "answers_missing"),
        (["analyse", made["study"], "--simulated"], "answers_missing"),
    ):
        assert run(["study", *arguments, "--out", str(folder / "new")]) == 2
        assert capsys.readouterr().err.endswith(f"[{code}]\n")
        assert not (folder / "new").exists()


def test_fabrics_of_equal_numbers_are_shown_by_different_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = SimulationPlan(simulations=3)
    one, other = FabricPrior.default().sample(range(2), seed=0)
    assert samples_apart([one, other, one, one], plan) == [0, 0, 3, 6]
    asked: list[Any] = []

    def refuse(fabrics: Any, plan: Any, **options: Any) -> Any:
        asked.append(options["first_repeats"])
        raise SimulationError("enough", code="enough")

    monkeypatch.setattr("services.web.study_pictures.simulate_fabrics", refuse)
    twins = [LibraryFabric("a", one), LibraryFabric("twin", one)]
    with pytest.raises(SimulationError):
        entries_from_library(twins, plan)
    assert asked == [[0, 3]]


def test_unusable_studies_name_the_way_out(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    library = str(folder / "library.json")
    (folder / "broken" / "a").mkdir(parents=True)
    (folder / "broken" / "a" / "x.jpg").write_bytes(b"no picture")
    (folder / "empty").mkdir()
    (folder / "bare" / "a").mkdir(parents=True)
    photos = ["make", "--photographs"]
    for arguments, message, code in (
        (["make"], "LIBRARY.json", "study_empty"),
        (["make", library, "--triplets", "10"], "reference 2 times", "triplets_few"),
        (["make", library, "--simulations", "0"], "simulations must be", "simulations_out_of_range"),
        ([*photos, str(folder / "none")], "no such folder", "file_missing"),
        ([*photos, str(folder / "empty")], "no subfolders", "study_empty"),
        ([*photos, str(folder / "broken")], "not a usable picture", "photograph_unreadable"),
        ([*photos, str(folder / "bare")], "no pictures of a", "study_pictures_missing"),
        (["analyse", "study_0"], "study list", "file_missing"),
        (["export", "study_0", "--out", str(folder / "x.txt")], ".csv or .json", "export_form"),
        (["simulate", "study_0"], "study list", "file_missing"),
        (["compare", "--simulations", "1"], "at least 2", "simulations_out_of_range"),
        (["compare", "--backends", "nothing"], "unknown back end", "backend_unknown"),
        (["compare", "--backends", " , "], "give at least one image distance", "backends_missing"),
    ):
        assert run(["study", *arguments]) == 2, arguments
        captured = capsys.readouterr()
        assert message in captured.err and captured.err.endswith(f"[{code}]\n"), (arguments, captured.err)
        assert captured.err.count("\n") == 1
        assert not (folder / "d.db").exists()


@pytest.mark.parametrize("command", ["make", "compare"])
def test_a_cache_that_cannot_be_is_told_in_words_that_help_and_leaves_nothing(
    command: str, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = {"make": [str(folder / "library.json")], "compare": ["--backends", "depth"]}[command]
    monkeypatch.setenv("DRAPEMETER_CACHE", str(folder / "library.json" / "cache"))
    before = sorted(folder.iterdir())
    assert run(["study", command, *arguments]) == 2
    assert capsys.readouterr().err.endswith(f"{OTHER_CACHE}\n")
    assert sorted(folder.iterdir()) == before


def analytic_drape(request: DrapeRequest) -> RequestResult:
    """Stands for a simulation: soft and heavy fabrics fold more, repeats differ by a shift."""
    y, x = np.mgrid[0:256, 0:256] / 255.0
    fabric = request.fabric
    folds = (fabric.density / fabric.bending_warp / fabric.stretch_warp**0.3) ** 0.2
    shift = 0.2 * np.random.default_rng(request.solver_seed(0)).normal()
    height = 0.03 * (1 + np.cos(folds * (2 * np.pi * x + shift))) * (0.2 + y) / folds**0.5
    cloth = np.abs(x - 0.5) < 0.4
    shaded = np.where(cloth, 60 + 2000 * height, 0).astype(np.uint8)
    return RequestResult(request, DrapeRender(shaded, np.where(cloth, 0.9 - height, 0).astype(np.float32)))


def test_comparison_of_image_distances(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("metric.simulate.run_request", analytic_drape)
    small = ["--fabrics", "3", "--steps", "3", "--simulations", "2", "--resolution", "0.025", "--workers", "1"]
    out = folder / "comparison"
    found = document(capsys, "study", "compare", "--backends", "depth,silhouette,trunk", *small, "--out", str(out))
    assert {s["name"] for s in found["scores"]} == {"depth", "silhouette", "trunk"}
    for score in found["scores"]:
        assert 0 <= score["self_nearest"] <= 1
        assert set(score["monotone"]) == {"bending", "stretch", "density"}
        assert set(score["by_simulations"]) == {"1", "2"}
    assert found["parameters"]["z-score"]["bending"] == 1.0
    assert (out / "shares.png").stat().st_size > 1000
    assert json.loads((out / "comparison.json").read_text()) == found


def losing(lost: Sequence[FabricParameters]) -> Callable[[DrapeRequest], RequestResult]:
    """Simulations of which some fabrics never come to rest."""

    def drape(request: DrapeRequest) -> RequestResult:
        if request.fabric in lost and request.scene is Scene.STRETCH:
            return RequestResult(request, None, ("diverged",))
        return analytic_drape(request)

    return drape


SMALL = ["--simulations", "2", "--resolution", "0.025", "--workers", "1"]


def test_a_fabric_that_cannot_be_simulated_is_named_and_the_others_are_analysed(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fabrics = FabricPrior.default().sample(range(8), seed=0)
    photos = ["--photographs", str(folder / "photos")]
    study = document(capsys, "study", "make", str(folder / "library.json"), *photos)["study"]
    document(capsys, "study", "simulate", study, "--observers", "5")
    analyse = ["study", "analyse", study, "--simulated", "--backends", "depth", "--bootstrap", "5", *SMALL, "--json"]

    kept = str(folder / "cache")
    monkeypatch.setenv("DRAPEMETER_CACHE", str(folder / "library.json" / "cache"))
    assert run(analyse) == 2
    assert capsys.readouterr().err.endswith(f"{OTHER_CACHE}\n")
    monkeypatch.setenv("DRAPEMETER_CACHE", kept)

    monkeypatch.setattr("metric.simulate.run_request", losing(fabrics[3:4]))
    assert run(analyse) == 0
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert "no metric is compared with people on fabric-3: 2 of 4 simulations did not come to rest" in said.err
    assert [lost["fabric"] for lost in found["left_out"]] == ["fabric-3"]
    assert set(found["metrics"]) == {"parameters", "parameters_values", "depth"}
    assert found["backends"] == {"depth": "depth"}
    for score in found["metrics"].values():
        assert [k for k, value in enumerate(score["per_fabric"]) if value is None] == [3]
        assert score["interval_95"] is not None and 0 <= score["answers_predicted"] <= 1

    monkeypatch.setenv("DRAPEMETER_CACHE", "")
    monkeypatch.setattr("metric.simulate.run_request", losing(fabrics[2:]))
    assert run(analyse) == 0
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert "no metric is compared with people: of 8 fabrics 2 could be simulated" in said.err
    assert found["metrics"] == {} and len(found["left_out"]) == 6
    assert found["agreement"]["questions"] >= 5 and len(found["embedding"]["points"]) == 8


def test_a_comparison_names_what_is_lost_and_goes_on_without_a_short_sweep(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRAPEMETER_CACHE", "")
    sweeps = {sweep.name: sweep.fabrics for sweep in default_sweeps(3)}
    monkeypatch.setattr("metric.simulate.run_request", losing([sweeps["density"][0]]))
    compared = ["study", "compare", "--backends", "depth", "--fabrics", "3", "--steps", "3", *SMALL, "--json"]
    assert run(compared) == 0
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert [lost["fabric"] for lost in found["left_out"]] == ["sweep density, step 1"]
    assert "sweep density is left out: 2 of its fabrics came to rest" in said.err
    assert set(found["scores"][0]["monotone"]) == {"bending", "stretch"}


def test_a_study_names_the_fabrics_that_cannot_be_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    library = [LibraryFabric(f"fabric-{k}", f) for k, f in enumerate(FabricPrior.default().sample(range(4), seed=0))]
    monkeypatch.setattr("metric.simulate.run_request", losing([library[1].parameters, library[3].parameters]))
    plan = SimulationPlan(simulations=2, resolution_m=0.025, workers=1)
    told = r"^fabric-1, fabric-3 could not be simulated \(of fabric-1 2 of 4 .*diverged\)\): take .*--seed"
    with pytest.raises(SimulationError, match=told) as caught:
        entries_from_library(library, plan)
    assert caught.value.code == "simulation_not_still"
    assert [len(entry.pictures) for entry in entries_from_library(library[::2], plan)] == [4, 4]
