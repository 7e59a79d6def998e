"""Labels stay sealed until they are opened, and are counted rightly."""

from __future__ import annotations

import hashlib
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from capture.capture_set import CAPTURES_FILE
from diagnosis.blind import same_catalogue
from diagnosis.blind.answers import REPORTS_FOLDER, Answer, answer_cases, open_label, open_labels, read_manifest
from diagnosis.blind.claims import Claims, alone
from diagnosis.blind.make import (
    BLIND_FORMAT,
    LABELS_FOLDER,
    MANIFEST_FILE,
    SHARED_BY,
    SHUFFLED,
    BlindPlan,
    case_maker,
    draw_kinds,
    draw_label,
    hidden_effects,
    is_sealed,
    make_blind_check,
    plan_of,
    simulable_wrong,
    visible_effects,
)
from diagnosis.blind.page import render_page
from diagnosis.blind.score import same, score
from diagnosis.effects import catalogue
from diagnosis.groups import group_of
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.synthesis import SynthesisPlan, real_fabric
from simcore.errors import InputError, SimulationError
from simcore.parameters import FabricParameters
from simcore.prior import is_admissible
from tests.diagnosis.blind_answers import CURL, DRAFT, HEM, MANIFEST, TILT, answer

PLAN = BlindPlan(1, 3, fabrics=1, repeats=1, pool=1, resolution_m=0.02, scenes=("stretch",))


def test_answers_are_counted() -> None:
    answers = [
        answer("named", [DRAFT], "air_draft", 0.9),
        answer("named", [DRAFT], "crease", 0.6),
        answer("none", [], "none", 0.7, detected=False),
        answer("withheld", [HEM], "unknown", 0.7),
        answer("withheld", [HEM], "crease", 0.95),
        answer("two", [DRAFT, HEM], "air_draft", 0.9),
    ]
    result = score(answers)
    assert (result.top1.hits, result.top1.of) == (1, 2)
    assert result.false_alarms.value == 0.0
    assert result.withheld_unknown.value == result.withheld_misnamed.value == 0.5
    assert (result.one_of_two.hits, result.both_of_two.hits) == (1, 0)
    assert result.magnitude_inside.hits == 1
    assert result.magnitude_error == pytest.approx(0.0909, abs=1e-3)
    page = render_page(MANIFEST, answers, result)
    assert "| case-001 | named | air_draft | crease | 0.60 |" in page


def test_a_pair_counts_with_all_that_it_has() -> None:
    """Two that are named share their probability in halves."""
    pair = answer("withheld", [CURL], "crease", 0.48)
    report = dict(pair.report)
    report["cause"] = {
        "top": "crease",
        "probabilities": {"crease": 0.48, "pin_drop": 0.47, "none": 0.05},
        "effects": [{"name": "crease"}, {"name": "pin_drop"}],
    }
    pair = Answer(pair.name, pair.label, report, pair.baselines)
    assert pair.certainty == pytest.approx(0.95)
    assert score([pair]).withheld_misnamed.hits == 1
    report["cause"]["both_probability"] = 0.6
    assert pair.certainty == 0.6 and score([pair]).withheld_misnamed.hits == 0
    twins = answer("named", [TILT], "panel_tilt", 0.6)
    report = {
        **twins.report,
        "cause": {**twins.report["cause"], "probabilities": {"panel_tilt": 0.6, "air_draft": 0.39}},
    }
    assert Answer(twins.name, twins.label, report, twins.baselines).certainty == pytest.approx(0.99)


def test_what_hanging_alone_cannot_show_is_not_drawn() -> None:
    both, hanging = BlindPlan(24, 0), BlindPlan(24, 0, scenes=("hanging",))
    lost = {e.name for e in visible_effects(both)} - {e.name for e in visible_effects(hanging)}
    assert lost == {"corner_pull"}
    assert set(hidden_effects({**MANIFEST, "scenes": ["hanging"]})) == {"corner_pull", "panel_friction"}


def test_the_page_tells_of_no_classifier_where_none_answered() -> None:
    unnamed = [answer("none", [], "none", 0.7, detected=False)]
    assert "classifier" not in score(unnamed).baselines


def test_a_case_that_cannot_be_simulated_stands_in_nobodys_way(tmp_path: Path) -> None:
    case_maker(tmp_path, BlindPlan(2, 3, fabrics=1, repeats=1, pool=1, resolution_m=0.02, scenes=("stretch",)))
    tried = []

    def make(number: int) -> None:
        tried.append(number)
        raise SimulationError(f"case {number} did not come to rest", code="capture_not_still")

    with pytest.raises(InputError, match="no case is diagnosed yet: give more time") as caught:
        answer_cases(tmp_path, cache=DrapeCache(None), make=make)
    assert caught.value.code == "blind_nothing_done"
    assert tried == [0, 1]
    failed = sorted((tmp_path / REPORTS_FOLDER).glob("*.failed"))
    assert [path.stem for path in failed] == ["case-001", "case-002"]
    assert "[capture_not_still]" in failed[0].read_text()


def test_declared_groups_count_as_one() -> None:
    assert same("panel_tilt", "air_draft") and same("crease", "crease")
    assert not same("crease", "air_draft")


def test_labels_are_sealed_in_files_of_their_own(tmp_path: Path) -> None:
    make_blind_check(tmp_path, PLAN, cache=DrapeCache(None))
    sealed = (tmp_path / LABELS_FOLDER / "case-001.json").read_bytes()
    stated = json.loads((tmp_path / "case-001" / "captures.json").read_text())
    assert stated["label_sha256"] == hashlib.sha256(sealed).hexdigest()
    assert "effects" not in stated and len(json.loads(sealed)["nonce"]) == 32
    with pytest.raises(InputError) as caught:
        make_blind_check(tmp_path, BlindPlan(1, 4, fabrics=1, repeats=1, pool=1), cache=DrapeCache(None))
    assert caught.value.code == "blind_other_plan"
    altered = json.loads(sealed)
    altered["kind"] = "none" if altered["kind"] != "none" else "named"
    (tmp_path / LABELS_FOLDER / "case-001.json").write_text(json.dumps(altered))
    with pytest.raises(InputError) as caught:
        open_label(tmp_path, "case-001", DrapeCache(None))
    assert caught.value.code == "blind_label_changed"


def test_a_case_that_was_not_finished_is_made_again(tmp_path: Path) -> None:
    (tmp_path / "captures.json").write_text('{"format": "drape-capture-set/1"}')
    assert not is_sealed(tmp_path)
    (tmp_path / "captures.json").write_text('{"label_sha256": "00"}')
    assert is_sealed(tmp_path)


def test_kinds_come_in_the_same_proportions_all_along() -> None:
    kinds = draw_kinds(BlindPlan(60, 5, withhold=("crease",)))
    assert kinds[:25].count("two") == kinds[25:50].count("two") == SHUFFLED["two"]
    assert draw_kinds(BlindPlan(30, 5, withhold=("crease",))) == kinds[:30]
    assert "withheld" not in draw_kinds(BlindPlan(60, 5))


def test_two_effects_are_of_two_groups() -> None:
    for seed in range(40):
        plan = BlindPlan(25, seed)
        for number, kind in enumerate(draw_kinds(plan)):
            if kind == "two":
                first, second = (effect.name for effect, _ in draw_label(number, plan).effects)
                assert second not in group_of(first)


def test_a_pair_needs_two_groups() -> None:
    """Two that are declared inseparable are left: a second effect would be drawn for ever."""
    left = ("air_draft", "panel_tilt")
    plan = BlindPlan(25, 0, withhold=tuple(name for name in catalogue() if name not in left))
    with pytest.raises(InputError, match="two declared groups"):
        plan.check()


def test_all_visible_effects_come_up() -> None:
    plan = BlindPlan(200, 5, withhold=("crease",))
    drawn = {
        e.name for n in range(plan.cases) for e, _ in draw_label(n, plan).effects if draw_label(n, plan).kind == "named"
    }
    assert "crease" not in drawn and "panel_friction" not in drawn
    assert len(drawn) >= 20


@pytest.mark.parametrize(
    "plan",
    [
        BlindPlan(0, 1),
        BlindPlan(1, 1, pool=2),
        BlindPlan(1, 1, withhold=("wind",)),
        BlindPlan(1, 1, withhold=tuple(catalogue())),
        BlindPlan(25, 1, withhold=("panel_friction",)),  # shows in no capture
        BlindPlan(25, 1, withhold=("corner_pull",), scenes=("hanging",)),
        BlindPlan(25, 1, withhold=("air_draft",)),  # a tilt is a right answer to it
        BlindPlan(1, 1, scenes=("hanging", "hanging")),
        BlindPlan(1, 1, resolution_m=0.0),
        BlindPlan(1, 1, resolution_m=0.013),
    ],
)
def test_plans_that_cannot_be_are_refused_and_leave_nothing(plan: BlindPlan, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        case_maker(tmp_path, plan)
    assert list(tmp_path.iterdir()) == []


def test_folders_without_a_check_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_manifest(tmp_path)
    assert caught.value.code == "blind_missing"
    for text in ('{"format": "other/1"}', "[]", json.dumps({"format": BLIND_FORMAT, "cases": 1})):
        (tmp_path / MANIFEST_FILE).write_text(text)
        with pytest.raises(InputError) as caught:
            read_manifest(tmp_path)
        assert caught.value.code == "blind_format"
    (tmp_path / MANIFEST_FILE).write_text("{")
    with pytest.raises(InputError) as caught:
        case_maker(tmp_path, BlindPlan(1, 1))
    assert caught.value.code == "blind_other_plan"


def test_a_check_is_not_gone_on_with_under_another_catalogue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Labels to come would be of another deck, and answers of two catalogues would be counted as one check's."""
    case_maker(tmp_path, BlindPlan(1, 1))
    case_maker(tmp_path, BlindPlan(1, 1))
    effects = dict(catalogue())
    odds = replace(effects["crease"], odds=(9.0, *effects["crease"].odds[1:]))
    assert plan_of(read_manifest(tmp_path)) == BlindPlan(1, 1)
    for changed in (effects | {"crease": odds}, {n: e for n, e in effects.items() if n != "crease"}):
        monkeypatch.setattr(same_catalogue, "catalogue", lambda changed=changed: changed)
        with pytest.raises(InputError) as caught:
            case_maker(tmp_path, BlindPlan(1, 1))
        assert caught.value.code == "blind_catalogue"


def test_a_group_of_cases_belongs_to_one_of_several_processes(tmp_path: Path) -> None:
    with Claims(tmp_path) as first, Claims(tmp_path) as second:
        assert first.take(0) and first.take(SHARED_BY - 1)
        assert not second.take(1) and second.take(SHARED_BY)
    with Claims(tmp_path) as third:
        assert third.take(0)


def test_labels_that_another_process_is_opening_come_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["case-001", "case-002", "case-003"]
    for name in names:
        sealed = json.dumps({"kind": "none", "effects": []}).encode()
        for folder in (name, LABELS_FOLDER, REPORTS_FOLDER):
            (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / LABELS_FOLDER / f"{name}.json").write_bytes(sealed)
        stated = {"label_sha256": hashlib.sha256(sealed).hexdigest()}
        (tmp_path / name / "captures.json").write_text(json.dumps(stated))
        (tmp_path / REPORTS_FOLDER / f"{name}.json").write_text(json.dumps({"baselines": {}}))
    order: list[str] = []
    monkeypatch.setattr("diagnosis.blind.answers.verify", lambda folder, *_: order.append(folder.name))
    with ThreadPoolExecutor(1) as pool:
        with alone(tmp_path, "case-001", wait=False) as mine:
            assert mine
            with alone(tmp_path, "case-001", wait=False) as again:
                assert not again
            opened = pool.submit(open_labels, tmp_path, names, DrapeCache(None))
            while len(order) < 2:
                assert not opened.done()
        assert [one.name for one in opened.result(timeout=60)] == names
    assert order == ["case-002", "case-003", "case-001"]


def test_a_check_that_is_only_planned_says_so(tmp_path: Path) -> None:
    case_maker(tmp_path / "cases", PLAN)
    with pytest.raises(InputError, match="planned and not made: give --make") as caught:
        answer_cases(tmp_path / "cases", cache=DrapeCache(tmp_path / "drapes"))
    assert caught.value.code == "blind_nothing_done"


@pytest.mark.parametrize("captures", [None, "{}", "[", '{"label_sha256": "0"}'])
def test_a_case_without_its_label_or_the_hash_is_not_opened(captures: str | None, tmp_path: Path) -> None:
    (tmp_path / "case-001").mkdir()
    if captures is not None:
        (tmp_path / "case-001" / CAPTURES_FILE).write_text(captures)
    if captures != '{"label_sha256": "0"}':  # the last has a hash and no label
        (tmp_path / LABELS_FOLDER).mkdir()
        (tmp_path / LABELS_FOLDER / "case-001.json").write_text("{}")
    with pytest.raises(InputError, match="the label of case-001 or its hash is missing") as caught:
        open_label(tmp_path, "case-001", DrapeCache(None))
    assert caught.value.code == "blind_label_missing"


def test_what_has_a_twin_in_the_catalogue_is_not_drawn_as_unknown() -> None:
    plan = BlindPlan(25, 1, withhold=("air_draft", "crease"))
    plan.check()
    labels = [draw_label(n, plan) for n in range(plan.cases)]
    assert {label.effects[0][0].name for label in labels if label.kind == "withheld"} == {"crease"}


def test_a_wrong_parameter_that_no_cloth_can_have_is_drawn_again() -> None:
    fabric = FabricParameters(1000, 800, 300, 3e-5, 3e-6, 1e-5, 0.2)
    plan, seed = SynthesisPlan(), [1, 2, 81]
    kept = simulable_wrong(("stretch_warp", 0.5), plan, (0, fabric), seed)
    assert kept == ("stretch_warp", 0.5)
    drawn = simulable_wrong(("bending_bias", 0.3), plan, (0, fabric), seed)
    assert drawn != ("bending_bias", 0.3) and drawn == simulable_wrong(("bending_bias", 0.3), plan, (0, fabric), seed)
    real = real_fabric(replace(plan, wrong=drawn), 0, fabric, first=True)
    assert is_admissible(real.as_array()[None])[0]
