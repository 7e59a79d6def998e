"""Something outside the catalogue: what is left over, is common to all fabrics and is predicted from the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block
from diagnosis.inference.changes import rim_forms
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.remainder import BY_CHANCE_NATS, NEAR_ENOUGH, Mixture
from diagnosis.inference.subtract import responses_at_place, without
from diagnosis.measurement.reference import CELLS, cell_centres
from diagnosis.simulation.sizes import node_weights, nodes
from tests.diagnosis.remainder_parts import COUNT, EFFECTS, ERROR_M, FABRICS, fabrics, linear_responses


def gains(blocks: list[Block], share: float = 1.0) -> dict[str, float]:
    """By family, of so much of what was measured."""
    mixture = Mixture.of(EFFECTS, blocks, LikelihoodModel())
    return dict(zip(mixture.families, mixture.gain([share * b.stated.measured for b in blocks]), strict=True))


def gain(blocks: list[Block]) -> float:
    return gains(blocks)["all"]


def test_a_form_that_all_fabrics_show_is_predicted_from_the_others() -> None:
    assert gain(fabrics(range(FABRICS), "smooth")) > 5.0


def test_how_another_simulator_differs_within_the_errors_is_nothing_unknown() -> None:
    blocks = fabrics(range(FABRICS), "smooth")
    assert all(float(np.mean((0.15 * block.stated.measured) ** 2)) < NEAR_ENOUGH for block in blocks)
    assert gains(blocks, 0.15)["all"] == 0.0 < 5.0 < gain(blocks)


@pytest.mark.parametrize("shown", [range(0), range(1)])
def test_chance_or_one_fabric_alone_predicts_nothing(shown: Sequence[int]) -> None:
    assert max(gains(fabrics(shown, "smooth")).values()) < 0.0


def test_weights_and_bends_show_where_they_were_put_on_the_cloth_on_trial() -> None:
    for family in ("weights", "bends"):
        found = gains(fabrics(range(FABRICS), family, probed=True))
        others = {name: value for name, value in found.items() if name not in (family, "one weight")}
        assert found[family] > 5.0 > max(others.values())
        assert family not in gains(fabrics(range(FABRICS), family))
        assert max(gains(fabrics(range(1), family, probed=True)).values()) < BY_CHANCE_NATS[family]


def along_edges(share: float) -> dict[str, float]:
    """Gains of so much of a weight along the bottom edge where each fabric shows one of its own along another edge."""
    found = []
    for number, block in enumerate(fabrics(range(0), None, probed=True)):
        weights = block.probes["weights"]
        change = share * weights[3] + 0.3 * (1, -1, -1, 1)[number] * weights[number % 3]
        view = replace(block.stated, measured=block.stated.measured + change / ERROR_M)
        found.append(replace(block, stated=view, wide=view))
    return gains(found)


def test_a_weak_weight_along_one_edge_shows_by_itself_and_not_among_others() -> None:
    found, none = along_edges(0.15), along_edges(0.0)
    assert found["weights"] < 0.0 < BY_CHANCE_NATS["one weight"] < found["one weight"]
    assert max(none["weights"], none["one weight"]) < 0.0


def test_one_fabric_that_was_not_probed_shows_no_probe() -> None:
    blocks = fabrics(range(FABRICS), "weights", probed=True)
    some = gains([*blocks[:-1], replace(blocks[-1], probes={})])
    assert 2.0 < some["weights"] < gains(blocks)["weights"]


def test_probes_that_do_what_an_effect_of_the_catalogue_does_are_nothing_unknown() -> None:
    blocks = fabrics(range(FABRICS), "weights", probed=True)
    typical = 1.0 / ERROR_M * np.ones((len(nodes(get_effect("hem_weight"))), 1))
    known = []
    for block in blocks:
        rows = block.stated.responses | {"hem_weight": typical * block.probes["weights"][3]}
        view = replace(block.stated, responses=rows)
        known.append(replace(block, stated=view, wide=view))
    found = Mixture.of((*EFFECTS, "hem_weight"), known, LikelihoodModel())
    described = dict(zip(found.families, found.gain([b.stated.measured for b in known]), strict=True))
    for family in ("weights", "one weight"):
        assert described[family] < 0.0 < gains(blocks)[family] - 5.0


def test_pins_are_moved_on_the_cells_they_were_probed_on() -> None:
    """Coarse responses that say otherwise are not heard."""
    blocks = fabrics(range(FABRICS), "pins")
    rng = np.random.default_rng(3)
    spoilt = [replace(b, pins=0.3 * rng.standard_normal(b.pins.shape), probes={"pins": b.pins}) for b in blocks]
    assert gains(spoilt)["pins"] == pytest.approx(gains(blocks)["pins"])


@pytest.mark.parametrize("family", ["rim", "lines", "picture", "pins"])
def test_a_change_shows_most_in_its_own_family_and_in_no_other(family: str) -> None:
    found = gains(fabrics(range(FABRICS), family))
    assert found[family] > found["all"] > 5.0
    others = {name: value for name, value in found.items() if name not in (family, "all")}
    if family == "rim":  # where lines end
        assert others.pop("lines") < 0.5 * BY_CHANCE_NATS["lines"]
    if family == "pins":  # of the same moves
        assert others.pop("one pin") < found["pins"]
    assert max(others.values()) < 0.0


def pins_gain(effects: Sequence[str], move: Sequence[float], family: str = "pins") -> float:
    """What pins alone, or one of them, gain in fabrics put up with all pins moved by two millimetres times ``move``."""
    blocks = []
    for block in fabrics(range(FABRICS), None, pins=(6,) * FABRICS):
        measured = block.stated.measured + 0.002 * np.array(move) @ block.pins / ERROR_M
        rows = {**block.stated.responses, "pin_spacing": linear_responses("pin_spacing", np.random.default_rng(5))}
        view = replace(block.stated, measured=measured, responses=rows)
        blocks.append(replace(block, stated=view, wide=view))
    mixture = Mixture.of(effects, blocks, LikelihoodModel())
    gained = mixture.gain([block.stated.measured for block in blocks])
    return float(dict(zip(mixture.families, gained, strict=True))[family])


def test_pins_moved_as_an_effect_of_the_catalogue_says_are_nothing_unknown() -> None:
    """Nor where the effect's own response is of other folds."""
    outward = [-0.5, 0, 0.5, 0, 0, 0]
    assert pins_gain(EFFECTS, outward) > 8.0
    assert pins_gain((*EFFECTS, "pin_spacing"), outward) < 2.0


def test_a_pin_that_no_effect_moves_so_stays_unknown() -> None:
    downward = [0, -1.0, 0, 0, 0, 0]
    assert pins_gain(EFFECTS, downward) > 8.0
    assert pins_gain((*EFFECTS, "pin_spacing"), downward) > 8.0


def test_one_pin_that_is_moved_shows_by_itself() -> None:
    """Whichever it is; moves of two pins, as an effect makes them, show less as one's."""
    downward, outward = [0, -1.0, 0, 0, 0, 0], [-0.5, 0, 0.5, 0, 0, 0]
    assert pins_gain(EFFECTS, downward, "one pin") > 8.0
    assert pins_gain(EFFECTS, outward, "one pin") < pins_gain(EFFECTS, outward)
    assert pins_gain((*EFFECTS, "pin_spacing"), outward, "one pin") < 2.0


def test_another_simulators_smooth_form_is_no_family_of_its_own() -> None:
    assert "forms" not in gains(fabrics(range(FABRICS), None))


def test_the_rim_is_raised_along_each_edge() -> None:
    rims = rim_forms()
    assert rims.shape == (len(cell_centres()), 8) and not rims[COUNT:].any()
    top = rims[:COUNT, 0].reshape(CELLS, CELLS)
    assert top[0].all() and not top[1:].any()
    np.testing.assert_allclose(rims[:COUNT, 1].reshape(CELLS, CELLS)[0], np.linspace(-1, 1, 2 * CELLS + 1)[1::2])


def test_fabrics_whose_pins_differ_in_number_can_still_be_mixed() -> None:
    assert np.isfinite(gain(fabrics(range(FABRICS), "smooth", pins=(4, 4, 8, 4))))


def test_one_fabric_predicts_nothing() -> None:
    assert set(gains(fabrics(range(FABRICS), "smooth")[:1]).values()) == {-np.inf}


def test_what_an_effect_of_another_size_would_change_is_granted() -> None:
    """A size that was fitted too small leaves something in all fabrics, which speaks for nothing unknown."""
    blocks = fabrics(range(FABRICS), "air_draft")
    small = {SCALAR: 0.15}
    left = [without(block, "air_draft", small).stated.measured for block in blocks]
    own = [responses_at_place(block.stated.responses, "air_draft", small) for block in blocks]
    mixture = Mixture.of(EFFECTS, blocks, LikelihoodModel())
    assert mixture.gain(left)[0] > 5.0 and mixture.gain(left, own).max() < 0.0


def test_responses_at_a_place_are_those_of_that_place_alone() -> None:
    effect = get_effect("crease")
    rows = np.arange(float(len(nodes(effect)) // len(effect.places) * len(effect.tried)))[:, None]
    size = {SCALAR: 0.8} | dict(effect.places[1])
    chosen = responses_at_place({"crease": rows}, "crease", size)
    weights = node_weights(effect, size)
    assert set(rows[weights != 0, 0]) <= set(chosen[:, 0]) and len(chosen) * len(effect.tried) == len(rows)
