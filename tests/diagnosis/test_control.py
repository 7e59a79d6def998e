"""What a shrinkage is held against: a wrong effect, the scene that counts, and parameters that are refitted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.inference.cause import Cause
from diagnosis.inference.evidence import Evidence
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.report import Shrinkage
from diagnosis.shrinkage import held_out
from diagnosis.shrinkage.held_out import Held, Judge, Measured, hold_out, measure_shrinkage, most_flexible_wrong, refit
from diagnosis.shrinkage.in_report import NOT_AFRESH, complete
from diagnosis.shrinkage.splits import Fold
from diagnosis.simulation.sizes import nodes
from simcore.parameters import LIMITS, FabricParameters
from tests.diagnosis.where_blocks import EFFECTS, FABRICS, NAMES, SHAPES, make_blocks, make_pixels

SIZES = {name: nodes(get_effect(name))[-1] for name in EFFECTS}
"""The largest one of each: its response is the whole shape."""
DRAFT = SHAPES["air_draft"]
QUIET = PixelBlock(np.zeros(0), {}, sensor_known=True)


def weighed(**best: float) -> dict[str, Evidence]:
    """Effects by what they explain at their best size, the largest one there is."""
    return {
        name: Evidence(name, 0.0, value, {}, SIZES.get(name, {"magnitude": 1.0}), {}, 0.0, {})
        for name, value in best.items()
    }


def cause_of(name: str, **best: float) -> Cause:
    """An effect that is named, and what others would explain."""
    return Cause({name: 1.0}, weighed(none=0.0, unknown=0.0, **{name: 9.0, **best}), 0.0)


def folds(blocks: Sequence[Block], parts: Mapping[str, Sequence[Block]], pixels: PixelBlock = QUIET) -> list[Fold]:
    """Parts of blocks, each held out in turn."""
    return [
        Fold(name, tuple(held), tuple(held), pixels, tuple(b for b in blocks if b not in held), pixels)
        for name, held in parts.items()
    ]


def by_fabric(blocks: Sequence[Block], pixels: PixelBlock = QUIET) -> list[Fold]:
    names = sorted({block.fabric for block in blocks})
    return folds(blocks, {name: [b for b in blocks if b.fabric == name] for name in names}, pixels)


def root_mean_square_mm(values: Sequence[np.ndarray]) -> float:
    return 1e3 * float(np.sqrt(np.mean([np.mean(v**2) for v in values])))


def metres(block: Block) -> np.ndarray:
    return block.metres(block.stated.measured)


@pytest.fixture
def drafty() -> list[Block]:
    """Three fabrics in a draft, two repeats in either scene."""
    return make_blocks(np.random.default_rng(2), DRAFT)


def found_on_the_others(monkeypatch: pytest.MonkeyPatch, causes: Mapping[str, Cause]) -> list[tuple[str, ...]]:
    """What is named without each fabric, in place of weighing; the list grows by the fabrics that were left in."""
    asked: list[tuple[str, ...]] = []

    def name(effects: Any, rest: Sequence[Block], *_: Any, **__: Any) -> Cause:
        asked.append(tuple(sorted({block.fabric for block in rest})))
        (out,) = {f"f{n}" for n in range(FABRICS)} - set(asked[-1])
        return causes[out]

    monkeypatch.setattr(held_out, "name_cause", name)
    return asked


def test_the_most_flexible_wrong_effect_is_neither_named_nor_inseparable_nor_chance() -> None:
    best = {"panel_tilt": 20.0, "bending_hysteresis": 40.0, "edge_curl": 5.0, "pin_spacing": 7.0, "depth_scale": 6.0}
    found = Cause({}, weighed(none=30.0, unknown=50.0, air_draft=12.0, **best), 0.0)
    assert most_flexible_wrong(found, cause_of("air_draft")) == ("pin_spacing", SIZES["pin_spacing"])
    assert most_flexible_wrong(found, cause_of("pin_spacing")) == ("panel_tilt", {"magnitude": 1.0})
    assert most_flexible_wrong(Cause({}, weighed(none=1.0, air_draft=2.0), 0.0), cause_of("air_draft")) is None


def test_a_block_is_held_against_a_wrong_effect_at_its_own_size(drafty: list[Block]) -> None:
    block = drafty[-1]
    wrong = ("edge_curl", SIZES["edge_curl"])
    left = metres(block) - np.tile(SHAPES["edge_curl"], 2)
    squares = hold_out(block, [("air_draft", SIZES["air_draft"])], wrong, Judge({})).squares
    assert squares[-1, 3] == pytest.approx(float(np.mean(left**2)))
    assert squares[-1, 1] < squares[-1, 0] < squares[-1, 3]
    right = hold_out(block, [("air_draft", SIZES["air_draft"])], ("air_draft", SIZES["air_draft"]), Judge({})).squares
    np.testing.assert_allclose(right[:, 3], right[:, 1])
    none = hold_out(block, [], None, Judge({})).squares
    np.testing.assert_allclose(none[:, 3], none[:, 0])
    np.testing.assert_allclose(none[:, 1], none[:, 0])


def test_the_control_is_what_each_fold_s_wrong_effect_would_have_gained(
    drafty: list[Block], monkeypatch: pytest.MonkeyPatch
) -> None:
    causes = {
        "f0": cause_of("air_draft", edge_curl=8.0, pin_spacing=2.0),
        "f1": cause_of("air_draft", edge_curl=2.0, pin_spacing=8.0),
        "f2": cause_of("air_draft"),
    }
    asked = found_on_the_others(monkeypatch, causes)
    stretch = drafty[FABRICS:]
    measured = measure_shrinkage(causes["f0"], EFFECTS, by_fabric(stretch), QUIET, LikelihoodModel())
    assert measured is not None and asked == [("f1", "f2"), ("f0", "f2"), ("f0", "f1")]
    found, control = measured.shrinkage, measured.shrinkage.control
    assert control is not None and control.effects == ("edge_curl", "pin_spacing", "none")
    wrong = [SHAPES["edge_curl"], SHAPES["pin_spacing"], np.zeros_like(DRAFT)]
    left = [metres(block) - np.tile(shape, 2) for block, shape in zip(stretch, wrong, strict=True)]
    assert control.after == pytest.approx(root_mean_square_mm(left))
    assert found.repeats is not None and found.repeats < control.after
    share = (found.before - control.after) / (found.before - found.repeats)
    assert control.fraction == pytest.approx(share)
    assert found.before == pytest.approx(root_mean_square_mm([metres(b) for b in stretch]))
    assert found.after == pytest.approx(root_mean_square_mm([metres(b) - np.tile(DRAFT, 2) for b in stretch]))
    assert found.fraction > 0.8 > control.fraction + 0.3


def test_only_stretch_counts_where_there_is_any(drafty: list[Block], monkeypatch: pytest.MonkeyPatch) -> None:
    cause = cause_of("air_draft", edge_curl=1.0)
    found_on_the_others(monkeypatch, dict.fromkeys(("f0", "f1", "f2"), cause))
    hanging, stretch = drafty[:FABRICS], drafty[FABRICS:]

    def shrunk(blocks: Sequence[Block]) -> Shrinkage:
        measured = measure_shrinkage(cause, EFFECTS, by_fabric(blocks), QUIET, LikelihoodModel())
        assert measured is not None
        assert {one.block.scene for one in measured.held} == {blocks[-1].scene}
        return measured.shrinkage

    both, alone, other = shrunk(drafty), shrunk(stretch), shrunk(hanging)
    assert both == alone != other
    assert set(both.held_out) == {name for block in stretch for name in block.captures}
    assert set(other.held_out) == {name for block in hanging for name in block.captures}


def test_of_a_single_repeat_the_scene_that_does_not_count_is_not_explained(
    drafty: list[Block], monkeypatch: pytest.MonkeyPatch
) -> None:
    cause = cause_of("air_draft", edge_curl=1.0)
    asked: list[str] = []

    def name(effects: Any, rest: Sequence[Block], *_: Any, **__: Any) -> Cause:
        asked.extend(block.scene for block in rest)
        return cause

    monkeypatch.setattr(held_out, "name_cause", name)
    own = [block for block in drafty if block.fabric == "f0"]
    scenes = folds(own, {block.scene: [block] for block in own})
    measured = measure_shrinkage(cause, EFFECTS, scenes, QUIET, LikelihoodModel())
    assert measured is not None and asked == ["hanging"]
    assert measured.shrinkage.held_out == own[-1].captures and own[-1].scene == "stretch"
    assert measured.shrinkage.control is not None and measured.shrinkage.control.effects == ("edge_curl",)


def test_what_was_refuted_is_not_named_on_the_others_either(
    drafty: list[Block], monkeypatch: pytest.MonkeyPatch
) -> None:
    cause = cause_of("air_draft")
    tried: list[tuple[tuple[str, ...], bool]] = []

    def name(effects: tuple[str, ...], *_: Any, pairs: bool) -> Cause:
        tried.append((effects, pairs))
        return cause

    monkeypatch.setattr(held_out, "name_cause", name)
    parts = by_fabric(drafty[-1:])
    measure_shrinkage(cause, EFFECTS, parts, QUIET, LikelihoodModel(), without={"edge_curl", "pin_spacing"})
    assert tried == [(("air_draft", "range_noise", "depth_scale"), False)]


def test_where_nothing_is_named_or_held_out_there_is_no_shrinkage(drafty: list[Block]) -> None:
    nothing = Cause({"none": 1.0}, weighed(none=0.0), 0.0)
    assert measure_shrinkage(nothing, EFFECTS, by_fabric(drafty), QUIET, LikelihoodModel()) is None
    assert measure_shrinkage(cause_of("air_draft"), EFFECTS, [], QUIET, LikelihoodModel()) is None


@pytest.mark.parametrize(("offset", "unit"), [(20.0, "standard deviations"), (2.5, "mm")])
def test_a_camera_s_fault_is_judged_by_the_shared_numbers_that_plainly_show_it(
    offset: float, unit: str, drafty: list[Block], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In either scene, and so is the wrong effect."""
    cause = cause_of("depth_scale", range_noise=5.0)
    found_on_the_others(monkeypatch, dict.fromkeys(("f0", "f1", "f2"), cause))
    quiet = replace(make_pixels(np.random.default_rng(0)), measured=np.zeros(len(NAMES)))
    pixels = replace(quiet, measured=np.where(np.array(NAMES) == "panel_offset", offset, 0.0))
    measured = measure_shrinkage(cause, EFFECTS, by_fabric(drafty, pixels), pixels, LikelihoodModel())
    assert measured is not None
    found = measured.shrinkage
    assert found.unit == unit and found.control is not None
    assert found.control.effects == ("range_noise",) * 3
    if unit == "mm":
        assert len(measured.held) == FABRICS and measured.seen == ()
        assert set(found.held_out) == {name for block in drafty[FABRICS:] for name in block.captures}
        return
    assert measured.held == () and {one.block.scene for one in measured.seen} == {"stretch"}
    assert set(found.held_out) == {name for block in drafty for name in block.captures}
    of_all = math.sqrt(len(NAMES))
    assert found.before == pytest.approx(offset / of_all) and found.repeats == 1.0
    assert found.after == pytest.approx((50.0 - offset) / of_all)
    assert found.control.after == pytest.approx(math.hypot(offset, 60.0) / of_all)
    assert found.control.fraction < -1.0


def test_parameters_are_refitted_as_far_as_they_are_uncertain() -> None:
    """One measurement that one parameter changes: the posterior mean of two normal distributions."""
    error, change, seen, taken = 0.001, 0.002, 0.006, 0.001
    factor = np.array([[math.hypot(error, change)]])
    view = View(np.array([seen]) / factor[0], {}, {}, factor, 0.0)
    one, still = np.zeros(1, np.intp), np.zeros((8, 1))
    jacobian = np.where(np.arange(7) == 2, change, 0.0)[:, None]
    found = refit(Block("f", "stretch", ("a",), view, view, one, one, jacobian, still, still), np.array([taken]))
    whole = error**2 + change**2
    assert found.deviation == pytest.approx(np.where(np.arange(7) == 2, change * (seen - taken) / whole, 0.0))
    assert found.left == pytest.approx([(seen - taken) * error**2 / whole])
    assert found.variance == pytest.approx([error**4 / whole])


def test_refitted_parameters_are_told_fabric_by_fabric() -> None:
    """Without and with the effect; those of the first part of a fabric that was held out, as far as there are such."""
    cloth = FabricParameters(1000.0, 800.0, 300.0, 1e-5, 2e-5, 1e-5, 0.2)
    task = SimpleNamespace(parameters=cloth, relative_sigma=(0.1,) * 6 + (0.02,))
    looks: Any = dict.fromkeys(("f1", "f2"), SimpleNamespace(result=SimpleNamespace(task=task)))

    def held(fabric: str, before: float, after: float) -> Held:
        block: Any = SimpleNamespace(fabric=fabric)
        return Held(block, (), np.zeros((0, 4)), np.full(7, before), np.full(7, after))

    made = Shrinkage(held_out=("a",), before=2.0, after=1.0, noise_floor=0.5, fraction=0.6, interval_90=(-1.0, 1.0))
    measured = Measured(made, (held("f1", 1.0, 0.0), held("f1", 3.0, 2.0), held("f2", 0.0, 500.0)))
    first, second = complete(measured, looks, lpips=False).parameters
    assert (first.fabric, second.fabric) == ("f1", "f2")
    stated = cloth.as_dict()
    grown = {name: value * math.exp(0.02 if name == "density" else 0.1) for name, value in stated.items()}
    assert first.before == pytest.approx(grown) and first.after == second.before == pytest.approx(stated)
    assert second.after == pytest.approx({name: LIMITS[name][1] for name in stated})
    assert complete(measured, {}, lpips=False) == made
    assert complete(measured, {}, lpips=True).note == f"not measured in LPIPS: {NOT_AFRESH}"
    assert complete(Measured(made, ()), looks, lpips=False).parameters == ()
