"""Two effects at once: each as uncertain as alone, and weighed against one alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from diagnosis.cause_report import as_can_be, as_likely, moved_along
from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference import pairs as pairs_module
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.inference.cause import Cause, name_cause
from diagnosis.inference.evidence import tabulate, tabulate_nothing
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.pairs import Pair
from diagnosis.inference.subtract import without
from diagnosis.inference.view_likelihood import Lengths, view_log_likelihood
from diagnosis.simulation.sizes import node_weights, nodes
from tests.diagnosis.pair_parts import evidence
from tests.diagnosis.response_rows import random_rows, still_rows

COUNT, FABRICS = 60, 4
DRAFT, CREASE = {SCALAR: 0.4}, {SCALAR: 1.0, "down": 1.0, "position": 0.5}
SIZES: dict[str, Mapping[str, float]] = {"air_draft": DRAFT, "crease": CREASE}
MODEL = LikelihoodModel()
NONE = np.zeros((0, COUNT))


def view(measured: np.ndarray, **known: Any) -> View:
    return View(measured, {}, {}, np.eye(len(measured)), 0.0, **known)


def test_what_was_taken_away_is_as_uncertain_as_what_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    one, two, left = (
        25.0 * rng.standard_normal(COUNT),
        3.0 * rng.standard_normal(COUNT),
        rng.standard_normal(COUNT),
    )

    def value(taken: tuple[np.ndarray, ...], tried: np.ndarray) -> float:
        seen = view(left + tried, taken=taken)
        return float(view_log_likelihood(seen, tried[None], np.ones((1, 1)), "stretch", MODEL)[0])

    assert value((one,), two) == pytest.approx(value((two,), one), abs=1e-6)
    assert value((one,), np.zeros(COUNT)) < value(
        (), one
    )  # what of one alone is shorter than the errors does not count
    with monkeypatch.context() as patched:
        of = Lengths.of
        patched.setattr(Lengths, "of", lambda *known, alone: of(*known, alone=False))
        assert value((one,), np.zeros(COUNT)) == pytest.approx(value((), one), abs=1e-6)
    assert value((one, two), np.zeros(COUNT)) == pytest.approx(value((one,), two), abs=1e-6)
    longer = left + 0.1 * one  # as much as a response's length errs

    def unexplained(left: np.ndarray, taken: tuple[np.ndarray, ...]) -> float:
        return float(view_log_likelihood(view(left, taken=taken), NONE, np.zeros((1, 0)), "stretch", MODEL)[0])

    lost = [unexplained(left, taken) - unexplained(longer, taken) for taken in ((), (one,))]
    assert 0.0 < lost[1] < 0.3 * lost[0]


def test_scatter_beside_what_was_taken_away_does_not_explain_its_length() -> None:
    rng = np.random.default_rng(5)
    name, strong = "bending_hysteresis", 20.0 * rng.standard_normal(COUNT)
    measured = rng.standard_normal(COUNT) + 0.08 * strong
    block, pixels = blocks_of({})[0], PixelBlock(np.zeros(0), {}, sensor_known=True)
    draws = np.concatenate([np.outer([0.3, -0.3, 0.3], strong * (block.owner == k)) for k in range(2)])
    gained = []
    for taken in ((), (strong,)):
        seen = View(measured, {}, {name: draws}, np.eye(COUNT), 0.0, taken=taken)
        own = [replace(block, stated=seen, wide=seen)]
        still = tabulate_nothing(own, pixels, MODEL).blocks[0]
        gained.append(float(tabulate(get_effect(name), own, pixels, MODEL).blocks[0].max() - still[0]))
    assert gained[0] > 2.0
    assert gained[1] < 0.2 * gained[0]


def blocks_of(sizes: Mapping[str, Mapping[str, float]], joint: float = 0.0, *, form: float = 0.0) -> list[Block]:
    """Four fabrics with some effects.

    Args:
        sizes: of the effects that are there.
        joint: how much of an own form the crease's response has where a draft is there, too.
        form: error of the draft's simulated response, in its own root mean square.
    """
    rng = np.random.default_rng(7)
    blocks = []
    for fabric in range(FABRICS):
        rows = {n: random_rows(rng, n, 6.0, COUNT) for n in SIZES}
        other = (1.0 - joint) * rows["crease"] + joint * random_rows(rng, "crease", 6.0, COUNT)
        shown = rows | {"crease": other} if len(sizes) == 2 else rows
        measured = rng.standard_normal(COUNT)
        for name, size in sizes.items():
            change = node_weights(get_effect(name), size) @ shown[name]
            wrong = form * np.sqrt(np.mean(change**2)) * rng.standard_normal(COUNT) if name == "air_draft" else 0.0
            measured = measured + change + wrong
        own = View(measured, rows, {}, np.eye(COUNT), 0.0, {("crease", "air_draft"): other} if joint else {})
        owner, cell = np.repeat([0, 1], COUNT // 2), np.tile(np.arange(COUNT // 2), 2)
        still = np.zeros((4, COUNT))
        blocks.append(
            Block(f"f{fabric}", "stretch", ("a", "b"), own, own, cell, owner, np.zeros((7, COUNT)), still, still)
        )
    return blocks


def named(blocks: Sequence[Block]) -> Cause:
    still = {n: still_rows(n) for n in SIZES}
    return name_cause(tuple(SIZES), blocks, PixelBlock(np.zeros(1), still, sensor_known=False))


def test_taken_away_an_effect_leaves_its_uncertainty_behind() -> None:
    block = blocks_of({"air_draft": DRAFT})[0]
    left = without(block, "air_draft", DRAFT)
    taken = node_weights(get_effect("air_draft"), DRAFT) @ block.stated.responses["air_draft"]
    np.testing.assert_allclose(left.stated.taken, [taken])
    np.testing.assert_allclose(left.stated.measured + taken, block.stated.measured)
    assert without(block, "bending_hysteresis", {SCALAR: 4.0, "seed": 1.0}) is block


def test_what_a_strong_effect_is_simulated_wrong_by_is_no_second_effect() -> None:
    assert named(blocks_of({"air_draft": DRAFT}, form=0.15)).named == ("air_draft",)


def test_a_weak_effect_beside_a_strong_one_is_named() -> None:
    assert set(named(blocks_of(SIZES)).named) == set(SIZES)


def test_two_effects_gain_as_much_where_magnets_hold_as_stated() -> None:
    """How probable the stated magnets are counts once, for one effect as for two."""
    gained = []
    for grip in (None, 1e-12 * np.ones(COUNT)):
        cause = named([replace(block, grip=grip) for block in blocks_of(SIZES)])
        assert cause.pair is not None
        gained.append(cause.pair.evidence.log_evidence - cause.evidence[cause.pair.first].log_evidence)
    assert gained[1] == pytest.approx(gained[0], abs=1e-6)


@pytest.mark.parametrize("scene", ["hanging", "stretch"])
def test_what_shows_in_pixels_gains_as_much_beside_an_effect_on_the_cloth(scene: str) -> None:
    """In ``hanging`` the cloth may rest in the folds that are seen without the latter, for two effects as for one."""
    names, pixel_name = ("air_draft", "edge_flying_pixels"), "edge_flying_pixels"
    blocks = blocks_of({"air_draft": DRAFT})
    count = len(nodes(get_effect(pixel_name)))
    still = {pixel_name: np.zeros((count, COUNT))}
    rows = [replace(b.stated, responses=b.stated.responses | still) for b in blocks]
    blocks = [replace(b, stated=row, wide=row) for b, row in zip(blocks, rows, strict=True)]
    where = [replace(b, scene="hanging") for b in blocks]
    unmoved = [replace(b.stated, measured=np.random.default_rng(n).standard_normal(COUNT)) for n, b in enumerate(where)]
    calm = [replace(b, stated=own, wide=own) for b, own in zip(where, unmoved, strict=True)]
    shown = {"air_draft": np.zeros((len(nodes(get_effect("air_draft"))), 1)), pixel_name: np.full((count, 1), 6.0)}
    pixels = PixelBlock(np.full(1, 6.0), shown, sensor_known=True)
    cause = name_cause(names, blocks + (calm if scene == "hanging" else []), pixels)
    assert cause.pair is not None and cause.pair.first == "air_draft"
    alone = cause.evidence[pixel_name].log_evidence - cause.evidence["none"].log_evidence
    assert alone > 3.0
    assert cause.pair.evidence.log_evidence - cause.evidence["air_draft"].log_evidence == pytest.approx(alone, abs=0.3)


def test_scatter_in_hanging_is_no_hysteresis_beside_an_effect_on_the_cloth() -> None:
    """Folds that fell there look like scatter: beside ``stretch`` that counts for nothing, of two effects as of one."""
    rng = np.random.default_rng(11)
    names, name = ("air_draft", "bending_hysteresis"), "bending_hysteresis"
    half = np.arange(COUNT) < COUNT // 2
    draws = np.concatenate([rng.standard_normal((3, COUNT)) * own for own in (half, ~half)])
    stretch = [replace(b.stated, scatter={name: draws}) for b in blocks_of({"air_draft": DRAFT})]
    fallen = [3.0 * rng.standard_normal(6) @ draws + rng.standard_normal(COUNT) for _ in stretch]
    hanging = [replace(v, measured=measured) for v, measured in zip(stretch, fallen, strict=True)]
    parts = blocks_of({"air_draft": DRAFT})
    blocks = [replace(b, stated=v, wide=v) for b, v in zip(parts, stretch, strict=True)]
    blocks += [replace(b, stated=v, wide=v, scene="hanging") for b, v in zip(parts, hanging, strict=True)]
    still = {n: still_rows(n) for n in names}
    cause = name_cause(names, blocks, PixelBlock(np.zeros(1), still, sensor_known=False))
    gained = [p.evidence.log_evidence - cause.evidence[p.first].log_evidence for p in cause.tried if p.second == name]
    assert cause.named == ("air_draft",)
    assert len(gained) == 1 and gained[0] < 0.0


@pytest.mark.parametrize("there", [True, False])
def test_an_effect_shows_beside_one_that_scatters(there: bool) -> None:
    rng = np.random.default_rng(3)
    name, half = "bending_hysteresis", np.arange(COUNT) < COUNT // 2
    blocks = []
    for block in blocks_of({"crease": SIZES["crease"]} if there else {}):
        draws = 20.0 * rng.standard_normal((4, COUNT))
        rows = np.concatenate([draws[:3] * own for own in (half, ~half)])
        seen = replace(block.stated, scatter={name: rows}, measured=block.stated.measured + 0.3 * draws[3])
        blocks.append(replace(block, stated=seen, wide=seen))
    names = ("air_draft", "crease", name)
    still = {n: still_rows(n) for n in names}
    cause = name_cause(names, blocks, PixelBlock(np.zeros(1), still, sensor_known=False))
    pair = next(pair for pair in cause.tried if pair.second == "crease" and pair.first == name)
    gained = pair.evidence.log_evidence - cause.evidence[name].log_evidence
    assert cause.evidence[name].log_evidence > cause.evidence["none"].log_evidence + 5.0
    assert gained > 4.0 if there else gained < 0.0


def test_both_are_named_where_they_were_simulated_together() -> None:
    blocks = blocks_of(SIZES, joint=1.0)
    alone = [replace(b, stated=replace(b.stated, beside={}), wide=replace(b.wide, beside={})) for b in blocks]
    assert set(named(blocks).named) == set(SIZES)
    assert "crease" not in named(alone).named


def test_a_second_effect_gains_more_than_what_a_strong_first_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = blocks_of(SIZES)
    both = named(blocks)
    monkeypatch.setattr(pairs_module, "HALVED", 0.0)  # however much the first leaves
    monkeypatch.setattr(pairs_module, "PICKED_UP", 5.0)
    one = named(blocks)  # nothing gains that much
    assert len(both.named) == 2 and both.pair_probability > 0.99
    assert len(one.named) < 2 and one.pair_probability < 0.01
    assert one.tried == both.tried, "what is simulated together is chosen by what both gain"


@pytest.mark.parametrize(("halved", "together"), [(1.0, True), (0.0, False)])
def test_what_halves_the_much_that_the_first_leaves_is_not_picked_up(
    monkeypatch: pytest.MonkeyPatch, halved: float, together: bool
) -> None:
    blocks = blocks_of(SIZES)
    monkeypatch.setattr(pairs_module, "PICKED_UP", 5.0)
    monkeypatch.setattr(pairs_module, "HALVED", halved)
    assert (len(named(blocks).named) == 2) is together


def test_what_is_smaller_than_an_effect_ever_is_may_be_picked_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a tilt of another simulator a corner pulled by 2.4 mm halved what a draft left."""
    blocks = blocks_of(SIZES)
    monkeypatch.setattr(pairs_module, "PICKED_UP", 5.0)
    monkeypatch.setattr(pairs_module, "HALVED", 1.0)
    monkeypatch.setattr(pairs_module, "is_usual", lambda name, size: False)
    assert len(named(blocks).named) < 2


@pytest.mark.parametrize(
    ("name", "size", "usual"),
    [
        ("corner_pull", {SCALAR: 0.0024}, False),
        ("corner_pull", {SCALAR: -0.004}, True),
        ("crease", CREASE, True),
        ("crease", {**CREASE, SCALAR: -0.4}, False),
        ("stretch_stiffening", {SCALAR: 0.02}, True),
        ("stretch_stiffening", {SCALAR: 0.5}, False),
        ("camera_rotation", {"rx": 0.1, "ry": 0.0, "rz": -0.1}, False),
        ("camera_rotation", {"rx": 0.6, "ry": -0.5, "rz": 0.1}, True),
    ],
)
def test_sizes_that_an_effect_may_have(name: str, size: Mapping[str, float], usual: bool) -> None:
    assert pairs_module.is_usual(name, size) is usual


def test_two_effects_on_one_sensor_are_named_by_what_was_rendered_with_both() -> None:
    names, numbers = ("dropout", "range_noise"), 8
    rng = np.random.default_rng(9)
    rows = {n: 30.0 * rng.standard_normal(numbers) * np.ones_like(still_rows(n)) for n in names}
    both = 30.0 * rng.standard_normal(numbers) * np.ones_like(rows["range_noise"])
    blocks = []
    for block in blocks_of({}):
        still = {n: np.zeros((len(r), COUNT)) for n, r in rows.items()}
        seen = replace(block.stated, responses=still)
        blocks.append(replace(block, stated=seen, wide=seen))
    pixels = PixelBlock(rows["dropout"][0] + both[0], rows, sensor_known=True)
    told = replace(pixels, beside={("range_noise", "dropout"): both})
    assert set(name_cause(names, blocks, told).named) == set(names)
    assert len(name_cause(names, blocks, pixels).named) < 2


def test_what_two_named_effects_are_not_told_from_is_judged_beside_each_other() -> None:
    """Single effects are all far behind; only what does as well beside the other one is as likely."""
    names = ("air_draft", "crease", "hem_weight", "off_grain", "none", "unknown")
    found = {name: evidence(name, -50.0, DRAFT) for name in names}
    pairs = [
        Pair("air_draft", other, SIZES, evidence(other, value, CREASE))
        for other, value in (("crease", 0.0), ("hem_weight", -1.0), ("off_grain", -9.0))
    ]
    probabilities = dict.fromkeys(names, 0.0) | {"air_draft": 0.5, "crease": 0.5}
    cause = Cause(probabilities, found, 50.0, pair=pairs[0], pair_probability=1.0, tried=tuple(pairs))
    assert set(cause.named) == {"air_draft", "crease"}
    assert as_likely(cause, "crease") == {"air_draft", "crease", "hem_weight"}
    assert as_likely(cause, "air_draft") == {"air_draft", "crease"}
    lowered = replace(pairs[0], evidence=replace(pairs[0].evidence, log_evidence=-20.0))  # by what the first gains
    assert as_likely(replace(cause, pair=lowered), "crease") == {"air_draft", "crease", "hem_weight"}


def test_an_interval_moves_along_with_a_size_that_another_effect_changes() -> None:
    hem = moved_along({SCALAR: (29.0, 62.0)}, {SCALAR: 43.0}, {SCALAR: 9.0})
    assert hem[SCALAR] == pytest.approx((29.0 * 9 / 43, 62.0 * 9 / 43))
    draft = moved_along({SCALAR: (0.1, 0.3)}, {SCALAR: 0.2}, {SCALAR: -0.1})  # of another sign: as wide as before
    assert draft[SCALAR] == pytest.approx((-0.2, 0.0))
    vector = moved_along({"tx": (1.0, 3.0), "ty": (0.0, 1.0)}, {"tx": 2.0, "ty": 0.5}, {"tx": 3.0, "ty": 0.5})
    assert vector == {"tx": (2.0, 4.0), "ty": (0.0, 1.0)}


def test_an_interval_holds_no_size_that_cannot_be() -> None:
    share = get_effect("edge_flying_pixels")
    assert as_can_be({SCALAR: (0.71, 1.39)}, share) == {SCALAR: (0.71, 1.0)}
    assert as_can_be({SCALAR: (-2.0, 0.5)}, get_effect("air_draft")) == {SCALAR: (-2.0, 0.5)}
