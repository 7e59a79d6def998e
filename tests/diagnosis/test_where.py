"""Where a difference lies: by region, by spatial kind, by stage; on measurements made up for it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from diagnosis.gap.kinds import kind_directions
from diagnosis.gap.regions import region_of_cells
from diagnosis.gap.stages import find_leads, no_numbers
from diagnosis.gap.where import where_gaps
from diagnosis.inference.cause import Cause, name_cause
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.measurement.reference import CELLS
from diagnosis.pages.where_figure import kind_map, region_map
from diagnosis.report import RegionGap
from tests.diagnosis.where_blocks import (
    BULGE,
    CENTRE,
    CLOTH,
    CURL,
    EFFECTS,
    NAMES,
    SHAPES,
    TIGHT,
    U,
    make_blocks,
    make_pixels,
)

MODEL = LikelihoodModel()
LOUD = np.where(np.array(NAMES) == "log_noise", 50.0, 0.0)


def found_in(
    added_m: np.ndarray | float = 0.0,
    numbers: np.ndarray | float = 0.0,
    *,
    effects: tuple[str, ...] = EFFECTS,
    scenes: tuple[str, ...] = ("hanging", "stretch"),
    seed: int = 1,
) -> tuple[Cause, tuple[RegionGap, ...]]:
    """Cause and rows of a set that shows something more than errors."""
    rng = np.random.default_rng(seed)
    blocks, pixels = make_blocks(rng, added_m, scenes), make_pixels(rng, numbers)
    cause = name_cause(effects, blocks, pixels, MODEL)
    return cause, where_gaps(blocks, pixels, cause, MODEL)


def one(rows: tuple[RegionGap, ...], value: str, scene: str = "stretch") -> RegionGap:
    """The row of a region, a kind or a stage."""
    (row,) = [r for r in rows if r.scene == scene and getattr(r, r.by) == value]
    return row


@pytest.mark.parametrize("seed", range(6))
def test_errors_alone_show_nowhere(seed: int) -> None:
    _, rows = found_in(seed=seed)
    assert min(row.p_adjusted for row in rows) > 0.05
    assert min(row.noise_floor for row in rows if row.by == "stage") >= 1.0
    below = [row for row in rows if row.by != "stage" and row.gap <= row.noise_floor]
    assert below and all(row.effect is None and row.explained == 0.0 for row in below)  # nothing to explain


@pytest.mark.parametrize("withheld", [False, True])
def test_a_curl_along_the_sides_shows_at_the_sides_and_as_shape(withheld: bool) -> None:
    effects = tuple(name for name in EFFECTS if name != "edge_curl" or not withheld)
    cause, rows = found_in(0.004 * CURL, effects=effects)
    assert cause.top == ("unknown" if withheld else "edge_curl")
    sides = one(rows, "sides")
    assert sides.p_adjusted < 1e-3 and sides.gap == pytest.approx(4.0, rel=0.1) and sides.noise_floor < 0.6
    for region in ("interior", "panel"):
        assert one(rows, region).p_adjusted > 0.05
    assert one(rows, "low_order").p_adjusted < 1e-3 and one(rows, "folds").p_adjusted < 1e-3
    assert one(rows, "pixels").p_adjusted > 0.05 and one(rows, "panel_plane").p_adjusted > 0.05
    if not withheld:
        assert (sides.stage, sides.effect) == ("fabric", "edge_curl") and sides.explained > 0.8
        assert one(rows, "fabric").p_adjusted < 1e-3
        assert one(rows, "sensor").p_adjusted > 0.05


def test_noise_of_the_sensor_shows_in_the_pixels_and_nowhere_in_the_shape() -> None:
    cause, rows = found_in(numbers=LOUD)
    assert cause.named == ("range_noise",)
    pixels, sensor = one(rows, "pixels"), one(rows, "sensor")
    assert pixels.p_adjusted < 1e-4 and pixels.unit == "standard deviations" and pixels.noise_floor == 1.0
    assert (pixels.stage, pixels.effect) == ("sensor", "range_noise") and pixels.explained > 0.95
    assert sensor.p_adjusted < 1e-4 and sensor.gap == pytest.approx(50.0, rel=0.1)
    others = [row for row in rows if row not in (pixels, sensor)]
    assert min(row.p_adjusted for row in others) > 0.05


def test_each_part_of_the_shape_says_by_itself_what_explains_it() -> None:
    """A draft is named; at the sides lies what only a curl explains."""
    bulge = SHAPES["air_draft"] + SHAPES["edge_curl"]
    rng = np.random.default_rng(2)
    blocks, pixels = make_blocks(rng, bulge, ("stretch",)), make_pixels(rng)
    cause = name_cause(EFFECTS, blocks, pixels, MODEL)
    assert set(cause.named) == {"air_draft", "edge_curl"}
    rows = where_gaps(blocks, pixels, cause, MODEL)
    assert one(rows, "sides").effect == "edge_curl" and one(rows, "sides").stage == "fabric"
    assert one(rows, "interior").effect == "air_draft" and one(rows, "interior").stage == "environment"
    assert one(rows, "fabric").effect == "edge_curl" and one(rows, "environment").effect == "air_draft"


def test_a_stage_is_judged_beside_what_is_named_of_another() -> None:
    """Pins pulled apart do much of what a draft does; beside the draft they have nothing to say."""
    cause, rows = found_in(0.009 * BULGE)
    assert cause.named == ("air_draft",)
    assert one(rows, "environment").p_adjusted < 1e-4 and one(rows, "setup").p_adjusted > 0.05
    assert one(rows, "environment").gap > 30.0 and one(rows, "setup").gap < 5.0
    without = tuple(name for name in EFFECTS if name != "air_draft")
    rng = np.random.default_rng(1)
    blocks, pixels = make_blocks(rng, 0.009 * BULGE), make_pixels(rng)
    alone = where_gaps(blocks, pixels, name_cause(without, blocks, pixels, MODEL), MODEL)
    assert one(alone, "setup").p_adjusted < 0.01 and one(alone, "setup").effect == "pin_spacing"


def test_what_a_named_effect_leaves_is_no_better_known_than_its_form() -> None:
    rng = np.random.default_rng(1)
    blocks, pixels = make_blocks(rng, 0.009 * BULGE + 0.003 * TIGHT, ("stretch",)), make_pixels(rng)
    cause = replace(name_cause(EFFECTS, blocks, pixels, MODEL, pairs=False), pair=None)
    assert cause.named == ("air_draft",)
    exact = replace(MODEL, form_share=0.0)
    gaps = [{lead.effect: lead.gap for lead in find_leads(blocks, pixels, cause, m)} for m in (MODEL, exact)]
    assert 1.0 < gaps[0]["pin_spacing"] < 0.95 * gaps[1]["pin_spacing"]


def test_where_nothing_can_explain_a_scene_its_gaps_are_told_all_the_same() -> None:
    """What repeats scatter tells nothing in ``hanging`` beside ``stretch``, and nothing else was tried."""
    rng = np.random.default_rng(1)
    blocks, pixels = make_blocks(rng, 0.009 * BULGE), make_pixels(rng)
    cause = name_cause(("pin_spacing",), blocks, pixels, MODEL)
    none = replace(cause, probabilities={"none": 1.0, "unknown": 0.0}, pair=None)
    rows = where_gaps(blocks, pixels, none, MODEL)
    assert {row.by for row in rows} == {"region", "kind"} and all(row.effect is None for row in rows)


def test_the_named_effect_stands_for_its_stage() -> None:
    rng = np.random.default_rng(1)
    blocks, pixels = make_blocks(rng, scenes=("stretch",)), make_pixels(rng, LOUD)
    cause = name_cause(EFFECTS, blocks, pixels, MODEL)
    other = replace(cause, probabilities={**cause.probabilities, "depth_scale": 2.0}, pair=None)
    sensors = [one(where_gaps(blocks, pixels, c, MODEL), "sensor").effect for c in (cause, other)]
    assert sensors == ["range_noise", "depth_scale"]


def test_where_no_effect_explains_anything_the_row_says_so() -> None:
    _, rows = found_in(0.004 * CURL, numbers=LOUD, effects=("air_draft", "pin_spacing"))
    pixels = one(rows, "pixels")
    assert (pixels.stage, pixels.effect, pixels.explained) == ("sensor", None, 0.0)
    assert {row.stage for row in rows if row.by == "stage"} == {"environment", "setup"}


def test_the_same_difference_is_less_sure_in_hanging() -> None:
    """Its errors are three times as large here, and so is what was added: the squares are the same."""
    _, folds = found_in(0.009 * CURL, scenes=("hanging",))
    _, taut = found_in(0.003 * CURL, scenes=("stretch",))
    for part in ("low_order", "folds"):
        assert one(folds, part, "hanging").gap == pytest.approx(3 * one(taut, part).gap)
        assert one(folds, part, "hanging").p_adjusted > 5 * one(taut, part).p_adjusted


def test_shared_numbers_count_in_one_scene() -> None:
    _, rows = found_in(numbers=LOUD)
    assert not [row for row in rows if row.scene == "hanging" and row.unit != "mm" and row.by == "kind"]
    assert one(rows, "sensor", "hanging").p_adjusted > 0.05
    _, alone = found_in(numbers=LOUD, scenes=("hanging",))
    assert one(alone, "pixels", "hanging").p_adjusted < 1e-4


def test_low_order_and_folds_share_the_cloth_between_them() -> None:
    block = make_blocks(np.random.default_rng(0), 0.002 * CURL, ("stretch",))[0]
    both = kind_directions(block, CENTRE)
    together = np.concatenate(list(both.values()))
    np.testing.assert_allclose(together @ together.T, np.eye(len(together)), atol=1e-9)
    assert len(together) == int(CLOTH[block.cell].sum())
    tilted = np.where(CLOTH, U**2 - 0.3 * U, 0.0)[block.cell]
    waves = np.where(CLOTH, np.cos(2 * np.pi * 4 * U), 0.0)[block.cell]
    for values, kind in ((tilted, "low_order"), (waves, "folds")):
        share = np.sum((both[kind] @ values) ** 2) / np.sum(values**2)  # type: ignore[index]  # both are kinds
        assert share > 0.95
    _, rows = found_in(0.004 * CURL, scenes=("stretch",))
    cells = region_of_cells("stretch", CENTRE)
    squares = sum(
        one(rows, region).gap ** 2 * int(cells[region].sum())
        for region in ("pins", "top_edge", "sides", "hem", "interior")  # type: ignore[index]
    )
    kinds = one(rows, "low_order").gap ** 2 + one(rows, "folds").gap ** 2
    assert kinds == pytest.approx(squares / CLOTH.sum())


def test_p_values_are_adjusted_for_all_rows_together() -> None:
    """Of independent tests the least p-value is multiplied by their number (Benjamini and Hochberg 1995)."""
    rng = np.random.default_rng(3)
    blocks, pixels = make_blocks(rng, 0.004 * CURL, ("stretch",)), make_pixels(rng)
    cause = name_cause(EFFECTS, blocks, pixels, MODEL)
    rows = where_gaps(blocks, pixels, cause, MODEL)
    assert len(rows) == 7 + 4 + 4
    fewer = where_gaps(blocks, no_numbers(pixels), cause, MODEL)
    assert one(rows, "sides").p_adjusted == pytest.approx(one(fewer, "sides").p_adjusted * 15 / 13)


def test_rows_are_by_contract(shared_dir: Path) -> None:
    schema = json.loads((shared_dir / "contracts" / "gap-report.schema.json").read_text())["properties"]["where"]
    _, rows = found_in(0.004 * CURL, LOUD)
    jsonschema.validate([row.model_dump(mode="json") for row in rows], schema)
    assert {row.by for row in rows} == {"region", "kind", "stage"}
    assert {row.kind for row in rows if row.by == "kind"} == {"pixels", "panel_plane", "low_order", "folds"}


def test_an_effect_that_is_another_in_every_repeat_shows_in_no_direction() -> None:
    rng = np.random.default_rng(6)
    blocks, pixels = make_blocks(rng, scenes=("stretch",), scatter_m=0.004), make_pixels(rng)
    cause = name_cause(("bending_hysteresis",), blocks, pixels, MODEL)
    rows = where_gaps(blocks, pixels, cause, MODEL)
    fabric = one(rows, "fabric")
    assert fabric.effect == "bending_hysteresis" and fabric.explained == 0.0
    assert fabric.gap > 1.5 and fabric.noise_floor == 1.0
    assert one(rows, "interior").effect is None and one(rows, "interior").stage == "fabric"


def test_maps_show_regions_and_kinds_where_they_are() -> None:
    rng = np.random.default_rng(5)
    blocks = make_blocks(rng, -0.004 * CURL, ("stretch",))
    shown = kind_map(blocks, "folds") + kind_map(blocks, "low_order")
    assert shown.shape == (CELLS, CELLS)
    np.testing.assert_allclose(shown[3:9, 0], 4.0, atol=0.7)  # nearer: positive
    np.testing.assert_allclose(shown[3:9, 4:8], 0.0, atol=0.7)
    row = {"scene": "stretch", "stage": "setup", "noise_floor": 0.5, "p_adjusted": 1.0}
    table = region_map(
        "stretch",
        [RegionGap(region="sides", gap=2.0, **row), RegionGap(region="panel", gap=0.5, **row)],
    )
    assert table[6, 1] == table[6, CELLS] == 4.0 and table[0, 3] == 1.0 and np.isnan(table[6, 6])


def test_folds_of_hanging_are_no_scatter_where_there_is_stretch() -> None:
    cause, rows = found_in(scenes=("hanging", "stretch"), effects=(*EFFECTS, "bending_hysteresis"))
    assert "bending_hysteresis" in cause.probabilities
    assert one(rows, "fabric", "hanging").effect != "bending_hysteresis"
    _, alone = found_in(scenes=("hanging",), effects=(*EFFECTS, "bending_hysteresis"))
    assert one(alone, "fabric", "hanging").p_adjusted > 0.05
