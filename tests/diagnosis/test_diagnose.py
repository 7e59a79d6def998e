"""Capture sets made with a known cause, diagnosed end to end."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import jsonschema
import pytest

from diagnosis.diagnose import DiagnosisOptions, conclude, diagnose
from diagnosis.extension import SimulatorExtension
from diagnosis.pages.html import render_html
from diagnosis.pages.sentence import sentence
from diagnosis.report import GapReport
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.steps import LOOKS
from simcore.drape import DrapeStatus
from simcore.errors import InputError
from tests.diagnosis.conftest import CANDIDATES, Diagnose, MakeSet


@pytest.fixture(scope="module")
def plain(make_set: MakeSet, explain: Diagnose) -> GapReport:
    return explain(make_set()).report


@pytest.fixture(scope="module")
def drafty(make_set: MakeSet, explain: Diagnose) -> GapReport:
    return explain(make_set("air_draft=0.3")).report


def test_a_set_without_an_effect_is_none(plain: GapReport) -> None:
    assert plain.cause.top == "none"
    assert not plain.gap.detected
    assert plain.cause.effects == ()
    assert plain.shrinkage is None


def test_a_draft_is_named(drafty: GapReport) -> None:
    assert drafty.cause.top == "air_draft"
    assert drafty.gap.detected
    assert drafty.gap.value > 3 * drafty.gap.noise_floor
    assert drafty.cause.probabilities["none"] < 0.01
    (found,) = drafty.cause.effects
    assert isinstance(found.magnitude, float)
    assert 0.15 < found.magnitude < 0.6
    assert drafty.shrinkage is not None
    assert drafty.shrinkage.after < drafty.shrinkage.before


def test_the_share_closed_follows_from_the_numbers_beside_it(drafty: GapReport) -> None:
    found = drafty.shrinkage
    assert found is not None and found.repeats is not None
    assert found.fraction == pytest.approx((found.before - found.after) / (found.before - found.noise_floor))
    assert found.noise_floor == min(found.repeats, found.after)
    assert found.interval_90[0] <= found.fraction <= found.interval_90[1]


def test_two_workers_find_what_one_finds(
    make_set: MakeSet, explain: Diagnose, shelf: DrapeCache, tmp_path: Path
) -> None:
    """Both begin with the same states: those that one search keeps may lead the next one farther."""
    captures = make_set("air_draft=0.3")
    explain(captures)
    assert shelf.folder is not None
    found = []
    steps: list[tuple[float, str]] = []
    for workers in (1, 2):
        shutil.copytree(shelf.folder, tmp_path / str(workers))
        options, kept = DiagnosisOptions(CANDIDATES, resolution_m=0.02, workers=workers), tmp_path / str(workers)
        found.append(diagnose(captures, options, cache=DrapeCache(kept), on_step=lambda *step: steps.append(step)))
    first, second = steps[: len(steps) // 2], steps[len(steps) // 2 :]
    assert first == second and first == sorted(first, key=lambda step: step[0])
    count = len({capture.fabric.id for capture in captures.captures})
    assert [what for _, what in first[: count + 1]] == [f"{done} of {count} fabrics" for done in range(count + 1)]
    assert [what for _, what in first[count + 1 :]] == [
        *(f"closer look {number} of {LOOKS}" for number in range(1, LOOKS + 1)),
        "how far the gap shrinks",
    ]
    assert found[1].looks["f1"].found  # simulated by another process, and come back
    assert found[1].looks["f1"].beside  # what second effects change where the draft is on
    times = {"cost": {"seconds", "solver_seconds"}}
    alone, together = (one.report.model_dump(exclude=times) for one in found)
    assert alone == together


def test_noise_of_the_sensor_is_named_though_the_cloth_is_as_simulated(make_set: MakeSet, explain: Diagnose) -> None:
    report = explain(make_set("range_noise=0.003")).report
    assert report.cause.top == "range_noise"
    assert report.cause.effects[0].magnitude == pytest.approx(0.003, rel=0.35)


def test_an_effect_that_is_withheld_is_not_called_none(make_set: MakeSet, explain: Diagnose) -> None:
    report = explain(make_set("air_draft=0.3"), effects=("range_noise", "depth_scale")).report
    assert report.gap.detected
    assert report.cause.top == "unknown"


def test_probabilities_sum_to_one_and_the_report_is_by_contract(
    plain: GapReport, drafty: GapReport, shared_dir: Path
) -> None:
    schema = json.loads((shared_dir / "contracts" / "gap-report.schema.json").read_text())
    for report in (plain, drafty):
        assert sum(report.cause.probabilities.values()) == pytest.approx(1.0, abs=1e-6)
        jsonschema.validate(report.as_json(), schema)


def test_the_page_holds_its_pictures_and_says_it_in_words(make_set: MakeSet, explain: Diagnose) -> None:
    found = explain(make_set("air_draft=0.3"))
    page = render_html(found, "a set")
    assert "air_draft" in sentence(found)
    assert "data:image/png;base64," in page
    assert "http://" not in page and "https://" not in page


def test_what_was_found_can_be_simulated_with(drafty: GapReport, tmp_path: Path) -> None:
    made = SimulatorExtension.of(drafty)
    made.save(tmp_path / "simulator.json")
    read = SimulatorExtension.load(tmp_path / "simulator.json")
    assert read == made
    assert read.effects[0].option.startswith("air_draft=magnitude:")


def test_files_that_are_no_extension_are_refused(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text("{}")
    with pytest.raises(InputError) as caught:
        SimulatorExtension.load(tmp_path / "x.json")
    assert caught.value.code == "extension_invalid"


def test_report_is_frozen(plain: GapReport) -> None:
    assert not dataclasses.is_dataclass(plain)
    with pytest.raises(ValueError, match="frozen"):
        plain.parameters_refitted = False  # type: ignore[misc]  # that is what is tested


def test_a_state_that_is_not_at_rest_is_told_of_whoever_simulated_it(make_set: MakeSet, explain: Diagnose) -> None:
    """Also one that a closer look put in another's place, or that is held otherwise than stated."""
    first, *others = explain(make_set()).results
    bases = [
        dataclasses.replace(c.base, drape=dataclasses.replace(c.base.drape, status=DrapeStatus.NOT_STILL))
        for c in first.captures
    ]
    captures = tuple(dataclasses.replace(c, base=base) for c, base in zip(first.captures, bases, strict=True))
    told = conclude([dataclasses.replace(first, captures=captures), *others], CANDIDATES, ("as stated",)).report.assumed
    assert told[0] == "as stated"
    assert {line.split(" is compared")[0] for line in told if "not at rest" in line} == {
        f"fabric {first.task.id} in {scene}" for scene in {c.scene for c in captures}
    }
    assert not any("not at rest" in line for line in conclude([first, *others], CANDIDATES).report.assumed)
