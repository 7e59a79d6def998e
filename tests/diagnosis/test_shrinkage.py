"""How far a gap shrinks on what is held out: other fabrics, else other repeats, else the other scene."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from capture.capture_set import CaptureSet
from diagnosis.diagnose import Diagnosis
from diagnosis.gap.floor import repeat_squares
from diagnosis.gathering import make_blocks
from diagnosis.inference.block import PixelBlock
from diagnosis.inference.cause import Cause
from diagnosis.inference.evidence import Evidence
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.noise import NoiseModel
from diagnosis.inference.pairs import Pair
from diagnosis.pages.html import render_html
from diagnosis.shrinkage import held_out as shrinkage
from diagnosis.shrinkage.held_out import Judge, Measured, hold_out, on_shapes
from diagnosis.shrinkage.in_report import complete
from diagnosis.shrinkage.splits import Fold, folds_of
from diagnosis.tasks.fabric_task import FabricResult
from metric.render import DrapeRender
from metric.weights import INSTEAD
from simcore.errors import MissingResourceError
from tests.diagnosis.conftest import CANDIDATES, Diagnose, MakeSet

NOISE = NoiseModel()


@pytest.fixture(scope="module")
def noisy(make_set: MakeSet) -> CaptureSet:
    """Two fabrics, their sensor noisier than stated."""
    return make_set("range_noise=0.003")


@pytest.fixture(scope="module")
def fabrics(make_set: MakeSet, explain: Diagnose) -> tuple[FabricResult, ...]:
    """Two fabrics without an effect, two repeats in ``stretch`` each."""
    return explain(make_set()).results


@pytest.fixture(scope="module")
def only(noisy: CaptureSet, explain: Diagnose) -> Callable[[int], Diagnosis]:
    """``only(n)``: the first fabric's first ``n`` captures, diagnosed."""

    def run(count: int) -> Diagnosis:
        own = [c for c in noisy.document.captures if c.fabric == "f1"][:count]
        return explain(CaptureSet(noisy.folder, noisy.document.model_copy(update={"captures": tuple(own)})))

    return run


def test_of_one_fabric_repeats_are_held_out(only: Callable[[int], Diagnosis]) -> None:
    found = only(2)
    assert found.cause.named == ("range_noise",)
    shrinkage = found.report.shrinkage
    assert shrinkage is not None and shrinkage.held_out == ("f1-stretch-0", "f1-stretch-1")
    assert shrinkage.fraction > 0.5
    assert not any("held out" in line for line in found.report.assumed)


def test_of_one_capture_nothing_is_and_the_report_says_so(only: Callable[[int], Diagnosis]) -> None:
    report = only(1).report
    assert report.cause.top == "range_noise" and report.shrinkage is None
    assert any("one capture alone: none is held out" in line for line in report.assumed)


def test_parts_of_a_set_are_held_out_in_turn(fabrics: tuple[FabricResult, ...]) -> None:
    both = list(fabrics)
    blocks = make_blocks(both, NOISE)
    by_fabric = folds_of(both, blocks, NOISE)
    assert [fold.name for fold in by_fabric] == ["f1", "f2"]
    assert by_fabric[0].held == (blocks[0],) == by_fabric[0].whole and by_fabric[0].rest == (blocks[1],)

    one = both[:1]
    by_repeat = folds_of(one, blocks[:1], NOISE)
    assert [[b.captures for b in fold.held] for fold in by_repeat] == [[("f1-stretch-0",)], [("f1-stretch-1",)]]
    assert [[b.captures for b in fold.rest] for fold in by_repeat] == [[("f1-stretch-1",)], [("f1-stretch-0",)]]
    (whole,) = by_repeat[0].whole
    assert whole is blocks[0]
    assert repeat_squares(whole, whole.metres(whole.stated.measured)) is not None

    alone = replace(one[0], captures=one[0].captures[:1])
    assert folds_of([alone], make_blocks([alone], NOISE), NOISE) == []
    scenes = in_two_scenes(alone)
    assert [fold.name for fold in folds_of([scenes], make_blocks([scenes], NOISE), NOISE)] == ["hanging", "stretch"]


def in_two_scenes(alone: FabricResult) -> FabricResult:
    """The one capture as if it were seen in either scene."""
    (capture,) = alone.captures
    return replace(alone, captures=(replace(capture, id="other", scene="hanging"), capture))


def test_a_single_repeat_is_held_against_the_scatter_of_all(fabrics: tuple[FabricResult, ...]) -> None:
    """The floor of one capture would else be what the model of errors expects: stated parameters, mesh and all."""
    one = fabrics[:1]
    (block,) = make_blocks(one, NOISE)
    part = folds_of(one, [block], NOISE)[0].held[0]
    modelled = hold_out(part, [], None, Judge({})).squares[-1, 2]
    scattered = hold_out(part, [], None, Judge({}), block).squares[-1, 2]
    assert scattered == pytest.approx(hold_out(block, [], None, Judge({})).squares[-1, 2])
    assert math.sqrt(scattered) < math.sqrt(modelled)


def test_held_out_shapes_are_judged_without_what_chance_does_to_them(fabrics: tuple[FabricResult, ...]) -> None:
    """Mixed pixels beside moved pins: one draw of them would stand against every capture."""
    spacing = ("pin_spacing", {"magnitude": 0.006})
    chance = [("edge_flying_pixels", {"magnitude": 0.5}), ("bending_hysteresis", {"magnitude": 9.0, "seed": 1.0})]
    assert on_shapes([spacing, *chance]) == [spacing]
    (block,) = make_blocks(fabrics[:1], NOISE)
    assert not Judge({}).response(block, chance).any()


def test_what_is_known_is_fitted_on_the_others_though_they_do_not_name_it(
    fabrics: tuple[FabricResult, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two fabrics each is explained by the other alone, which names nothing; held out, it is judged all the same."""
    names, sizes = ("pin_spacing", "air_draft"), ({"magnitude": 0.006}, {"magnitude": 0.3})
    evidence = {name: Evidence(name, 0.0, 0.0, {}, {}, {}, 0.0, {}) for name in (*names, "none", "unknown")}
    pair = Pair(*names, dict(zip(names, sizes, strict=True)), evidence["none"])
    nothing = Cause({"none": 1.0}, evidence, 0.0, tried=(pair,))
    both = Cause({names[0]: 0.51, names[1]: 0.49}, evidence, 0.0, pair, 1.0)
    monkeypatch.setattr(shrinkage, "name_cause", lambda *given, **options: nothing)
    blocks = make_blocks(fabrics, NOISE)
    pixels = PixelBlock(np.zeros(0), {}, sensor_known=True)
    folds = folds_of(fabrics, blocks, NOISE)
    for known, expected in ((True, tuple(zip(names, sizes, strict=True))), (False, ())):
        found = shrinkage.measure_shrinkage(both, names, folds, pixels, LikelihoodModel(), known=known)
        assert found is not None and found.shrinkage.named_without == ((names,) * 2 if known else ((), ()))
        assert found is not None and len(found.held) == 2
        assert all(one.effects == expected for one in found.held)
        assert all((one.squares[-1, 1] == one.squares[-1, 0]) is not known for one in found.held)


def test_what_a_camera_or_sensor_changes_shrinks_in_depth_too(make_set: MakeSet, explain: Diagnose) -> None:
    """Depths 2 % too long: 18 mm at 0.9 m, of which folds and edges are left."""
    diagnosis = explain(make_set("depth_scale=0.02"))
    assert "In millimetres of depth, pixel by pixel" in render_html(diagnosis, "scaled")
    found = diagnosis.report.shrinkage
    assert found is not None and found.unit == "standard deviations"
    depth = found.depth
    assert depth is not None and depth.captures == 4
    assert depth.before == pytest.approx(18.0, abs=1.5)
    assert depth.after < 0.4 * depth.before  # fold by fold the repeats differ by 4 mm, too
    assert depth.noise_floor is not None and 1.0 < depth.noise_floor < 6.0
    assert depth.fraction is not None and depth.interval_90 is not None
    assert depth.interval_90[0] <= depth.fraction <= depth.interval_90[1] <= 1.0 and depth.fraction > 0.6
    regions = {one.region: one for one in depth.regions}
    assert set(regions) == {"pins", "top_edge", "sides", "hem", "interior", "panel"}
    assert regions["panel"].before == pytest.approx(18.0, abs=1.0) and regions["panel"].after < 4.0
    assert all(one.before > one.after and one.fraction is not None for one in regions.values())
    assert found.parameters == ()


def test_noise_of_pixels_does_not_shrink_in_depth(only: Callable[[int], Diagnosis]) -> None:
    found = only(2).report.shrinkage
    assert found is not None and found.depth is not None
    assert found.depth.before == found.depth.after > 2.5
    assert found.depth.fraction is None and found.depth.interval_90 is None  # a repeat held out alone has no floor


class Shades:
    """A back end whose distance is the mean difference of shades."""

    name = "shades"

    def features(self, renders: list[DrapeRender]) -> list[NDArray[np.float64]]:
        return [render.need_shaded().astype(np.float64) for render in renders]

    def table(self, one: list[NDArray[np.float64]], other: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        return np.array([[np.abs(a - b).mean() for b in other] for a in one])


def test_pictures_come_nearer_with_the_effect_and_without_weights_the_note_says_so(
    make_set: MakeSet, explain: Diagnose, monkeypatch: pytest.MonkeyPatch
) -> None:
    diagnosis = explain(make_set("air_draft=0.3"))
    shrinkage = diagnosis.report.shrinkage
    assert shrinkage is not None and shrinkage.perceived is None
    measured = Measured(shrinkage, diagnosis.held)
    with monkeypatch.context() as patch:
        patch.setattr("diagnosis.shrinkage.perception.get_backend", lambda _: Shades())
        seen = complete(measured, diagnosis.looks, lpips=True).perceived
    assert seen is not None and seen.backend == "shades"
    assert seen.captures == sum(len(one.block.captures) for one in diagnosis.held)
    assert seen.after < 0.7 * seen.before
    assert seen.noise_floor is not None and seen.noise_floor < seen.before
    assert seen.fraction is not None and seen.interval_90 is not None
    assert seen.fraction > 0.3 and seen.interval_90[0] <= seen.fraction <= seen.interval_90[1]
    page = render_html(
        replace(diagnosis, report=diagnosis.report.model_copy(update={"shrinkage": shrinkage})), "drafty"
    )
    for region in shrinkage.regions:
        assert region.fraction is not None and region.interval_90 is not None
        assert region.interval_90[0] <= region.fraction <= region.interval_90[1]
        assert region.noise_floor == min(region.after, region.repeats or math.inf)
        assert f"{region.interval_90[0]:.2f} to {region.interval_90[1]:.2f}" in page
    whole = {region.region: region for region in shrinkage.regions}["interior"]
    assert whole.fraction == pytest.approx((whole.before - whole.after) / (whole.before - whole.noise_floor))

    def missing(_: str) -> Shades:
        raise MissingResourceError(f"weights of LPIPS are missing, {INSTEAD}", code="weights_missing")

    monkeypatch.setattr("diagnosis.shrinkage.perception.get_backend", missing)
    without = complete(measured, diagnosis.looks, lpips=True)
    assert without.perceived is None
    assert without.note == "not measured in LPIPS: weights of LPIPS are missing"


def test_parts_without_shared_numbers_are_not_judged_by_them(noisy: CaptureSet, explain: Diagnose) -> None:
    """Of a set whose captures differ in what is stated, some parts may share no number: they say nothing, not NaN."""
    found = explain(noisy)
    assert found.cause.named == ("range_noise",)
    kept = list(found.results)
    folds = folds_of(kept, list(found.blocks), NOISE)
    dumb = replace(folds[0].held_pixels, measured=np.zeros(0), responses={})

    def measured(parts: list[Fold]) -> Measured:
        shrunk = shrinkage.measure_shrinkage(found.cause, CANDIDATES, parts, found.pixels, LikelihoodModel())
        assert shrunk is not None
        return shrunk

    whole, part = measured(folds), measured([replace(folds[0], held_pixels=dumb), *folds[1:]])
    assert whole.shrinkage.unit == part.shrinkage.unit == "standard deviations"
    assert set(part.shrinkage.held_out) < set(whole.shrinkage.held_out)
    assert math.isfinite(part.shrinkage.before) and math.isfinite(part.shrinkage.control.after)
    none = measured([replace(fold, held_pixels=dumb) for fold in folds])
    assert none.shrinkage.unit == "mm" and math.isfinite(none.shrinkage.before)
