"""What the page of a report shows and advises."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.diagnose import Diagnosis
from diagnosis.effects import catalogue, get_effect
from diagnosis.gap.where import where_gaps
from diagnosis.inference.cause import Cause, name_cause
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.pages.advice import CORRECTED, KIND_CHECKS, MODELLED, REGION_CHECKS, STAGE_CHECKS, advice, strongest
from diagnosis.pages.html import _after, _bars, _maps, render_html, size_text
from diagnosis.remedies import KNOWN
from diagnosis.report import FoundEffect, GapReport, RegionGap, Shrinkage
from diagnosis.scene import SimulationScene
from diagnosis.simulation.simulator import Cost
from simcore.scenes import Setup
from tests.diagnosis.plain_report import report
from tests.diagnosis.where_blocks import CURL, EFFECTS, make_blocks, make_pixels


def row(p: float = 0.001, gap: float = 3.0, floor: float = 0.5, **other: Any) -> RegionGap:
    given = {"scene": "stretch", "region": "all", "stage": "fabric", **other}
    return RegionGap(gap=gap, noise_floor=floor, p_adjusted=p, **given)


def advised(told: GapReport, scenes: tuple[str, ...] = ("stretch",), fabrics: int = 2, estimated: int = 0) -> str:
    captures = [SimpleNamespace(scene=scene) for scene in scenes]
    seen = SimulationScene(Setup.nominal("stretch")).with_sensor(range_noise_m=0.001, at_m=1.2)
    taken = [SimpleNamespace(scene=seen) for _ in scenes]
    tasks = [SimpleNamespace(id=f"f{n + 1}", captures=taken, estimated=n < estimated) for n in range(fabrics)]
    results = [SimpleNamespace(task=task, captures=captures) for task in tasks]
    made: Any = SimpleNamespace(report=told, results=results)
    return "\n".join(advice(made))


@pytest.mark.parametrize("top", [*catalogue(), "none", "unknown"])
def test_there_is_something_to_do_next_whatever_was_found(top: str) -> None:
    assert advised(report(top))


def test_of_a_named_effect_it_is_said_how_to_make_sure_of_it_and_what_then() -> None:
    hem = advised(report("hem_weight"))
    assert "adds mass along the bottom edge" in hem and "turned by a quarter" in hem and "--apply" in hem
    bias = advised(report("depth_bias"))
    assert "bare panel at two distances" in bias and "take it off the depths" in bias
    assert "--apply" not in bias


def test_parameters_that_were_estimated_from_these_captures_are_asked_for() -> None:
    """Not where nothing is missing: they are good then."""
    assert "State the parameters as measured" in advised(report("panel_tilt"), estimated=2)
    assert "State the parameters of f1 as measured" in advised(report("unknown"), estimated=1)
    assert "State the parameters" not in advised(report("panel_tilt")) + advised(report("none"), estimated=2)


def test_what_a_capture_set_cannot_state_is_not_to_be_corrected_there() -> None:
    seen = {name for name, effect in catalogue().items() if effect.stage.value in ("camera", "sensor")}
    assert set(CORRECTED) == seen
    stated = {name for name in seen if "capture set (sensor." in advised(report(name))}
    assert stated == {"range_noise", "quantisation"}
    assert {name for name in seen if "--apply" in advised(report(name))} == set(MODELLED)


def test_of_noise_what_is_to_be_stated_is_all_of_it() -> None:
    told = report("range_noise")
    effect = told.cause.effects[0].model_copy(update={"magnitude": 0.00335})
    told = told.model_copy(update={"cause": told.cause.model_copy(update={"effects": (effect,)})})
    said = "sensor.range_noise_m 0.0035 with sensor.at_m 1.2: 1 mm at that distance by what is stated, 3.35 mm more"
    assert said in advised(told)
    assert "sensor.at_m" not in advised(report("quantisation"))


def test_of_something_unknown_the_advice_goes_where_the_gap_lies() -> None:
    rows = (
        row(by="region", region="hem", gap=2.0),
        row(by="region", region="pins", gap=4.0),
        row(by="region", region="interior", gap=9.0, p=0.2),
        row(by="region", gap=9.0),
        row(by="region", scene="hanging", region="sides", gap=30.0),
        row(by="kind", kind="folds", gap=2.0),
        row(by="kind", kind="low_order", gap=4.0),
        row(by="stage", stage="setup", effect="pin_drop", unit="standard deviations", gap=8.0, floor=1.0),
        row(by="stage", stage="camera", effect="camera_rotation", unit="standard deviations", gap=4.0, floor=3.0),
    )
    text = advised(report("unknown", rows=rows))
    for check in (REGION_CHECKS["pins"], KIND_CHECKS["low_order"], STAGE_CHECKS["setup"]):
        assert check in text
    assert "pin_drop" in text and "stands out most at pins (4.00 mm against a floor of 0.50" in text
    for check in (REGION_CHECKS["hem"], REGION_CHECKS["interior"], REGION_CHECKS["sides"], STAGE_CHECKS["camera"]):
        assert check not in text
    assert "not tried" not in text


def test_of_something_unknown_that_no_stage_comes_near_to_the_turned_sample_is_asked_for() -> None:
    text = advised(report("unknown", rows=(row(by="region", region="hem"), row(by="stage", p=0.3, effect="crease"))))
    assert REGION_CHECKS["hem"] in text and "turned by a quarter" in text and "crease" not in text


def test_of_something_unknown_that_shows_nowhere_repeats_are_asked_for() -> None:
    assert "taken down and hung again" in advised(report("unknown", rows=(row(by="region", region="hem", p=0.4),)))


def test_effects_that_were_left_out_are_named_where_the_cause_is_unknown() -> None:
    told = report("unknown")
    fewer = {name: p for name, p in told.cause.probabilities.items() if name not in ("crease", "off_grain")}
    told = told.model_copy(update={"cause": told.cause.model_copy(update={"probabilities": fewer})})
    assert "crease, off_grain were not tried" in advised(told)


def test_of_no_effect_nothing_is_to_be_done_and_isolability_says_what_would_have_shown() -> None:
    text = advised(report("none"))
    assert "Nothing needs to be done" in text and "--isolability" in text and "Yet" not in text
    odd = advised(report("none", rows=(row(by="region", region="hem"),)))
    assert "Yet hem differs in stretch (3.00 mm against a floor of 0.50): one fabric with wrong parameters" in odd
    panel = advised(report("none", rows=(row(by="kind", kind="panel_plane"),)))
    assert KIND_CHECKS["panel_plane"] in panel and "wrong parameters" not in panel


def test_a_wide_gap_or_a_part_of_the_catalogue_is_no_reason_to_do_nothing() -> None:
    told = report("none")
    wide = told.model_copy(update={"gap": told.gap.model_copy(update={"value": 3.0})})
    few = {name: p for name, p in told.cause.probabilities.items() if name != "crease"}
    part = told.model_copy(update={"cause": told.cause.model_copy(update={"probabilities": few})})
    for one in (wide, part):
        assert "say little against one" in advised(one) and "Nothing needs" not in advised(one)


def test_where_little_speaks_against_an_effect_more_is_asked_for() -> None:
    detected = report("none")
    detected = detected.model_copy(update={"gap": detected.gap.model_copy(update={"detected": True})})
    for told, fabrics, word in (
        (detected, 2, "there is a gap"),
        (report("none", p=0.7), 2, "say little against one"),
        (report("none"), 1, "say little against one"),
    ):
        text = advised(told, fabrics=fabrics)
        assert word in text and "Nothing needs" not in text
    fewer = {name: p for name, p in report("none").cause.probabilities.items() if name != "crease"}
    few = report("none")
    few = few.model_copy(update={"cause": few.cause.model_copy(update={"probabilities": fewer})})
    assert "crease were not tried" in advised(few)


def test_where_no_effect_is_hardly_likelier_than_one_captures_that_decide_are_asked_for() -> None:
    told = report("none", p=0.45)
    cause = told.cause.model_copy(update={"probabilities": told.cause.probabilities | {"pin_spacing": 0.4}})
    text = advised(told.model_copy(update={"cause": cause}))
    assert "Add repeats and fabrics" in text and "pin_spacing" in text and "Nothing needs" not in text


def test_each_pair_that_captures_do_not_tell_apart_gets_what_separates_it() -> None:
    text = advised(report("depth_bias", alike=("camera_translation", "depth_scale", "off_grain")))
    for other in ("camera_translation", "depth_scale"):
        assert f"To tell depth_bias from {other}: {KNOWN[frozenset({'depth_bias', other})]}." in text
    assert "To tell depth_bias from off_grain: capture once more with the sample turned by a quarter." in text
    draft = advised(report("air_draft", alike=("panel_tilt",)))
    assert "To tell air_draft from panel_tilt: add fabrics of other weight" in draft
    assert "To tell" not in advised(report("unknown", alike=("panel_tilt",)))


def test_of_two_named_effects_each_is_told_from_its_own_kind() -> None:
    told = report("depth_scale", alike=("panel_tilt",))
    draft = FoundEffect(name="air_draft", stage="environment", magnitude=0.2, unit="Pa", interval_90=(0.1, 0.3))
    cause = told.cause.model_copy(update={"effects": (*told.cause.effects, draft)})
    assert "To tell air_draft from panel_tilt" in advised(told.model_copy(update={"cause": cause}))


def test_of_two_named_effects_what_captures_do_not_tell_apart_goes_with_the_one_it_is_like() -> None:
    told = report("depth_scale", alike=("panel_adhesion",))
    draft = FoundEffect(name="air_draft", stage="environment", magnitude=0.2, unit="Pa", interval_90=(0.1, 0.3))
    alike: dict[str, tuple[str, ...]] = {"depth_scale": (), "air_draft": ("panel_adhesion",)}
    cause = told.cause.model_copy(update={"effects": (*told.cause.effects, draft), "alike": alike})
    assert "To tell air_draft from panel_adhesion" in advised(told.model_copy(update={"cause": cause}))


def test_a_single_fabric_and_a_missing_stretch_are_asked_for() -> None:
    text = advised(report("none"), scenes=("hanging",), fabrics=1)
    assert "stretch scene" in text and "other fabrics" in text


def test_rows_beneath_their_floor_are_not_where_the_gap_lies() -> None:
    assert strongest((row(by="region", region="hem", gap=0.4, floor=0.5),)) == []
    only = row(by="region", scene="hanging", region="hem")
    assert strongest((only,)) == [only]


@pytest.fixture(scope="module")
def made() -> Diagnosis:
    rng = np.random.default_rng(1)
    blocks, pixels, model = make_blocks(rng, 0.004 * CURL), make_pixels(rng), LikelihoodModel()
    cause: Cause = name_cause(EFFECTS, blocks, pixels, model)
    rows = where_gaps(blocks, pixels, cause, model)
    told = report("edge_curl", rows=rows)
    return Diagnosis(told, (), tuple(blocks), cause, pixels, ())


def test_the_page_shows_regions_kinds_and_stages_in_tables_and_pictures(made: Diagnosis) -> None:
    page = render_html(made, "a set")
    lines = re.findall(r"<tr[^>]*>.*?</tr>", page, flags=re.DOTALL)
    assert len([line for line in lines if re.search("<td>(stretch|hanging)</td>", line)]) == len(made.report.where)
    for one in made.report.where:
        cells = {"region": one.region, "kind": one.kind, "stage": one.stage}[one.by]
        own = [line for line in lines if f"<td>{one.scene}</td><td>{cells}</td>" in line]
        assert any(f">{one.gap:.2f}<" in line and one.unit in line for line in own), one
    sides = next(line for line in lines if "<td>stretch</td><td>sides</td>" in line)
    assert 'class="sure"' in sides and "<td>fabric</td>" in sides and "<td>edge_curl</td>" in sides
    assert page.count('alt="where, ') == page.count("data:image/png;base64,") == 2
    assert "What to do next" in page


def test_sizes_are_told_to_three_digits_and_lengths_in_millimetres() -> None:
    length = FoundEffect(
        name="pin_spacing", stage="setup", magnitude=0.0055841581, unit="m", interval_90=(0.003732209, 0.008349146)
    )
    assert size_text(length) == "5.58 mm (90 % interval 3.73 to 8.35)"
    share = {"name": "dropout", "stage": "sensor", "magnitude": 0.0152, "unit": "1", "interval_90": (0.01, 0.02)}
    assert size_text(FoundEffect.model_validate(share)) == "1.52 % (90 % interval 1 to 2)"
    friction = {"name": "panel_friction", "stage": "environment", "magnitude": 0.4, "interval_90": (0.3, 0.5)}
    assert size_text(FoundEffect.model_validate(share | friction)) == "0.4 (90 % interval 0.3 to 0.5)"  # is no share
    turn = FoundEffect(
        name="camera_rotation",
        stage="camera",
        magnitude={"rx": 0.61, "ry": -0.2},
        unit="deg",
        interval_90={"rx": (0.35, 0.86), "ry": (-0.4, 0.1)},
    )
    assert size_text(turn) == "rx 0.61 deg (90 % interval 0.35 to 0.86), ry -0.2 deg (90 % interval -0.4 to 0.1)"


def test_the_place_of_an_effect_is_told_but_no_seed() -> None:
    crease = FoundEffect.model_validate(
        {"name": "crease", "stage": "fabric", "magnitude": 1.0, "unit": "rad", "interval_90": (0.8, 1.2)}
        | {"place": {"down": 1.0, "position": 0.5}}
    )
    assert size_text(crease) == "1 rad (90 % interval 0.8 to 1.2), down 1, position 0.5"
    random = {"name": "bending_hysteresis", "unit": "1/m", "place": {"seed": 1.0}}
    assert "seed" not in size_text(FoundEffect.model_validate(crease.model_dump() | random))


@pytest.mark.parametrize(("repeats", "names"), [(1.0, []), (2.0, ["repeats"]), (None, [])])
def test_where_repeats_lie_farther_than_the_explained_ones_both_are_drawn(
    made: Diagnosis, repeats: float | None, names: list[str]
) -> None:
    shrinkage = Shrinkage(
        held_out=("a",), before=6.0, after=1.0, noise_floor=1.0, repeats=repeats, fraction=1.0, interval_90=(0.8, 1.0)
    )
    shown = replace(made, report=made.report.model_copy(update={"shrinkage": shrinkage}))
    assert [name for name, _, _ in _bars(shown)] == ["before", "after", "noise floor", *names]


def test_what_is_simulated_for_the_page_counts(made: Diagnosis) -> None:
    look: Any = SimpleNamespace(simulator=SimpleNamespace(cost=Cost(simulations=3, cached=2, seconds=1.5)))
    shown = replace(made, looks={"f1": look}, spent=Cost(simulations=4))
    cost = shown.recounted().report.cost
    assert (cost.simulations, cost.cached, cost.solver_seconds) == (7, 2, 1.5)
    assert cost.seconds == made.report.cost.seconds


@pytest.mark.parametrize("top", ["depth_bias", "dropout", "pin_drop"])
def test_the_picture_with_what_was_found_shows_it_or_is_left_out(top: str) -> None:
    """Of a bias all that is seen is farther; holes are chance; what diverged is nothing that was found."""
    plain = SimulationScene(Setup.nominal("stretch"))
    flat = np.full((4, 4), 0.9, dtype=np.float32)
    capture: Any = SimpleNamespace(fabric="f1", reference=SimpleNamespace(depth=flat))
    vertices = np.full((2, 3), np.nan if top == "pin_drop" else 0.0)
    drape = SimpleNamespace(drape=SimpleNamespace(ok=False, vertices=vertices))
    look: Any = SimpleNamespace(drape=lambda *_: drape, scene_of=lambda _: plain, picture=lambda *_: flat)
    cause: Any = SimpleNamespace(named=(top,), size=lambda name: get_effect(name).typical())
    after = _after(SimpleNamespace(looks={"f1": look}, cause=cause), capture)  # type: ignore[arg-type]
    if top == "depth_bias":
        assert after is not None and (after > flat).all()
    else:
        assert after is None


def test_maps_show_what_was_simulated_afresh(made: Diagnosis) -> None:
    """As the picture beside them does; here it changes nothing, whatever the table of responses says."""
    block = made.blocks[0]
    captures = [SimpleNamespace(id=name, base=None) for name in block.captures]
    look = SimpleNamespace(
        result=SimpleNamespace(captures=captures),
        drape=lambda *_: SimpleNamespace(drape=SimpleNamespace(ok=True)),
        change=lambda *_: np.zeros(int(block.cell.max()) + 1),
    )
    afresh: Any = {block.fabric: look}
    assert made.cause.named
    for looks, alike in (({}, False), (afresh, True)):
        (_, without), (_, found) = _maps(block, replace(made, looks=looks))
        assert np.array_equal(without, found, equal_nan=True) is alike
