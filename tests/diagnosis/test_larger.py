"""Captures that differ from their simulations by more than simulators do for no reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.inference.cause import Cause, name_cause
from diagnosis.inference.larger import (
    CALM_NATS,
    PLAIN_NATS,
    larger_nats,
    larger_than_chance,
    usual_square,
)
from diagnosis.simulation.sizes import node_weights, nodes
from tests.diagnosis.response_rows import random_rows, still_rows

COUNT = 60
NAMES = ("hem_weight", "crease")


def fabrics(
    squares: Sequence[float], hem: float | None = None, scene: str = "stretch", sensed: float = 0.0
) -> list[Block]:
    """Fabrics with errors of these mean squares, and a hem of so many g/m."""
    rng = np.random.default_rng(11)
    blocks = []
    for fabric, square in enumerate(squares):
        measured = rng.standard_normal(COUNT)
        measured *= np.sqrt(square / np.mean(measured**2))
        rows = {n: random_rows(rng, n, 4.0, COUNT) for n in NAMES}
        effect = get_effect("hem_weight")
        one = 4.0 * rng.standard_normal(COUNT)
        rows["hem_weight"] = np.array([size[SCALAR] for size in nodes(effect)])[:, None] / 30.0 * one
        if hem is not None:
            measured = measured + node_weights(effect, {SCALAR: hem}) @ rows["hem_weight"]
        view = View(measured, rows, {}, 0.001 * np.eye(COUNT), 0.0)
        owner, cell = np.repeat([0, 1], COUNT // 2), np.tile(np.arange(COUNT // 2), 2)
        still = np.zeros((4, COUNT))
        jacobian, warps = np.zeros((7, COUNT)), np.zeros((8, COUNT))
        blocks.append(
            Block(f"f{fabric}", scene, ("a", "b"), view, view, cell, owner, jacobian, still, warps, sensed=sensed)
        )
    return blocks


def named(blocks: Sequence[Block]) -> Cause:
    still = {n: still_rows(n) for n in NAMES}
    return name_cause(NAMES, blocks, PixelBlock(np.zeros(1), still, sensor_known=False))


def test_a_square_is_told_in_units_of_the_usual_errors() -> None:
    """Under smaller errors residuals of the same cloth are larger, which is nothing more than they are."""
    usual = fabrics([0.5, 0.6, 0.7])
    smaller = [replace(block, calm_square=2.0) for block in fabrics([1.0, 1.2, 1.4])]
    assert usual_square(smaller) == pytest.approx(usual_square(usual))


def test_odds_rise_from_calm_to_plain_and_no_further() -> None:
    assert larger_nats(0.0) == larger_nats(0.5) == CALM_NATS
    odds = [larger_nats(square) for square in (0.8, 1.0, 1.3, 1.7, 2.1)]
    assert odds == sorted(odds) and odds[0] < 0.0 < odds[-1]
    assert larger_nats(0.88) < -3.0 and larger_nats(1.25) < 0.0  # the most where nothing is, decision 032
    assert larger_nats(2.3) == larger_nats(50.0) == pytest.approx(PLAIN_NATS)


def test_one_fabric_of_several_says_nothing() -> None:
    assert usual_square(fabrics([0.2, 0.2, 30.0])) == pytest.approx(0.2)
    assert usual_square(fabrics([0.2, 30.0])) == pytest.approx(0.2)
    assert usual_square(fabrics([30.0])) is None
    assert larger_than_chance([fabrics([30.0])], []) == -np.inf


def test_only_stretch_is_heard_and_what_pixels_noise_makes_of_it_is_not_counted() -> None:
    assert usual_square(fabrics([2.0, 2.0], scene="hanging")) is None
    assert usual_square(fabrics([0.6, 0.6, 0.6], sensed=0.5)) == pytest.approx(0.2)
    assert usual_square(fabrics([0.6, 0.6, 0.6], sensed=0.9)) is None


def test_the_way_magnets_hold_that_leaves_least_counts() -> None:
    assert larger_than_chance([fabrics([1.3] * 3), fabrics([0.2] * 3)], []) == CALM_NATS


def test_what_an_effect_explains_is_nothing_larger() -> None:
    large, calm = fabrics([2.4] * 4), fabrics([0.2] * 4)
    assert larger_than_chance([large], []) == PLAIN_NATS
    assert larger_than_chance([large], [(9.0, [large])]) == PLAIN_NATS  # it leaves as much
    assert larger_than_chance([large], [(0.5, [calm])]) == PLAIN_NATS  # it gains too little
    assert larger_than_chance([large], [(2.0, [calm])]) == pytest.approx(2.0 + CALM_NATS)
    assert larger_than_chance([large], [(2.0, None)]) == pytest.approx(2.0 + CALM_NATS)  # any scatter is explained


def test_fabrics_that_all_differ_in_ways_of_their_own_are_unknown() -> None:
    assert named(fabrics([0.2] * 4)).probabilities["none"] > 0.9
    assert named(fabrics([0.2, 0.2, 0.2, 4.0])).top == "none"
    large = named(fabrics([2.4] * 4))
    assert large.top == "unknown" and large.probabilities["none"] < 0.3


def test_an_effect_that_explains_them_is_named() -> None:
    found = named(fabrics([0.2] * 4, hem=30.0))
    assert usual_square(fabrics([0.2] * 4, hem=30.0)) == pytest.approx(16.0, rel=0.5)
    assert found.named == ("hem_weight",) and found.probabilities["hem_weight"] > 0.9
