"""How magnets hold: one amount for all fabrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, View, whiten
from diagnosis.inference.cause import Cause, name_cause
from diagnosis.inference.holds import HOLDS, held, holds_of, log_weights, tried_with_two
from diagnosis.simulation.sizes import node_weights, nodes
from tests.diagnosis import where_blocks
from tests.diagnosis.response_rows import random_rows, still_rows

COUNT, FABRICS = 60, 4
UNIT_M = 0.001
NAMES = ("stretch_stiffening", "crease")
STIFF = {SCALAR: 0.04}


def fabrics(shares: Sequence[float], size: dict[str, float] | None = None) -> list[Block]:
    """Fabrics whose magnets hold so much otherwise than stated; of a soft one that moves 40 times the errors.

    Half of what stiffening does to a fabric is what other magnets do to it.
    """
    rng = np.random.default_rng(3)
    blocks = []
    for fabric, share in enumerate(shares):
        grip = 40.0 * rng.standard_normal(COUNT)
        rows = {n: random_rows(rng, n, 6.0, COUNT) for n in NAMES}
        effect = get_effect("stretch_stiffening")
        one = 10.0 * rng.standard_normal(COUNT) - (10.0, 30.0)[fabric % 2] / 40.0 * grip
        rows[effect.name] = np.array([0.04**2 / s[SCALAR] ** 2 for s in nodes(effect)])[:, None] * one
        measured = rng.standard_normal(COUNT) + share * grip
        if size is not None:
            measured = measured + node_weights(effect, size) @ rows[effect.name]
        view = View(measured, rows, {}, UNIT_M * np.eye(COUNT), 0.0)
        owner, cell = np.repeat([0, 1], COUNT // 2), np.tile(np.arange(COUNT // 2), 2)
        still = np.zeros((4, COUNT))
        own = Block(
            f"f{fabric}", "stretch", ("a", "b"), view, view, cell, owner, np.zeros((7, COUNT)), still, still, sensed=1.0
        )
        blocks.append(replace(own, grip=UNIT_M * grip))
    return blocks


def named(blocks: Sequence[Block]) -> Cause:
    still = {n: still_rows(n) for n in NAMES}
    return name_cause(NAMES, blocks, PixelBlock(np.zeros(1), still, sensor_known=False))


def test_a_block_is_held_by_taking_away_what_the_magnets_do() -> None:
    (block,) = fabrics([0.3])
    assert block.grip is not None
    for before, after in zip(block.views, held(block, 0.3).views, strict=True):
        np.testing.assert_allclose(after.measured, before.measured - 0.3 * block.grip / UNIT_M)
    assert held(block, 0.0) is block
    hanging = replace(block, scene="hanging")
    assert held(hanging, 0.3) is hanging


def test_only_where_blocks_show_how_magnets_hold_is_it_averaged_over() -> None:
    blocks = fabrics([0.0, 0.0])
    assert holds_of(blocks) == HOLDS
    assert holds_of([replace(b, grip=None) for b in blocks]) == (0.0,)
    assert holds_of([replace(b, grip=np.zeros(COUNT)) for b in blocks]) == (0.0,)
    assert holds_of([replace(b, scene="hanging") for b in blocks]) == (0.0,)


def test_as_stated_is_the_most_probable_and_all_shares_add_up() -> None:
    weights = np.exp(log_weights(HOLDS))
    assert weights.sum() == pytest.approx(1.0) and weights.argmax() == HOLDS.index(0.0)


def test_two_effects_are_tried_with_the_most_probable_magnets_and_with_the_stated_ones() -> None:
    weights = np.log(np.full(3, 1 / 3))
    assert tried_with_two([[-9.0, -1.0], [-1.5, -9.0], [-30.0, -30.0]], weights) == [0]
    assert tried_with_two([[-9.0, -1.0], [-1.5, -9.0], [-0.5, -9.0]], weights) == [2, 0]


@pytest.mark.parametrize("share", [0.0, 0.2, 0.45])
def test_magnets_that_hold_alike_everywhere_are_no_effect(share: float) -> None:
    assert named(fabrics([share] * FABRICS)).top == "none"


def test_magnets_do_not_hide_an_effect_that_does_otherwise_to_each_fabric() -> None:
    cause = named(fabrics([0.0] * FABRICS, STIFF))
    assert cause.named == ("stretch_stiffening",)
    assert cause.size("stretch_stiffening")[SCALAR] == pytest.approx(STIFF[SCALAR], rel=0.1)


def test_an_effect_is_found_beside_magnets_that_hold_otherwise() -> None:
    cause = named(fabrics([0.3] * FABRICS, STIFF))
    assert cause.named == ("stretch_stiffening",)
    assert cause.size("stretch_stiffening")[SCALAR] == pytest.approx(STIFF[SCALAR], rel=0.1)


def test_the_usual_size_of_a_camera_is_the_one_that_fits() -> None:
    """How sharp a fit is under other magnets says nothing of how usual the size is."""
    ring = ~where_blocks.CLOTH
    forms = np.stack(
        [
            np.where(ring, 0.004 * (where_blocks.U - 0.5), 0.001 * (where_blocks.V - 0.5)),
            np.where(ring, 0.004 * (where_blocks.V - 0.5), 0.001 * where_blocks.U),
            0.002 * np.sin(3 * where_blocks.U) * where_blocks.CLOTH,
        ]
    )
    rows = np.tile(np.concatenate([forms, -forms]), (1, where_blocks.REPEATS))
    corner = where_blocks.CLOTH * np.exp(-8 * ((where_blocks.U - 1) ** 2 + where_blocks.V**2))
    grip = np.tile(0.016 * corner, where_blocks.REPEATS)
    rng = np.random.default_rng(2)
    blocks = [
        replace(
            block,
            stated=replace(
                block.stated, responses=dict(block.stated.responses) | {name: whiten(block.stated, rows.T).T}
            ),
            wide=replace(block.wide, responses=dict(block.wide.responses) | {name: whiten(block.wide, rows.T).T}),
            grip=grip,
        )
        for name in ("camera_translation",)
        for block in where_blocks.make_blocks(rng, forms[0] + 0.5 * forms[1], scenes=("stretch",))
    ]
    pixels = where_blocks.make_pixels(rng)
    still = {"camera_translation": np.zeros((6, len(where_blocks.NAMES)))}
    pixels = replace(pixels, responses=dict(pixels.responses) | still)
    cause = name_cause((*where_blocks.EFFECTS, "camera_translation"), blocks, pixels, pairs=False)
    found = cause.evidence["camera_translation"]
    assert cause.top == "camera_translation"
    assert found.usual == found.size
    assert found.usual_evidence == pytest.approx(found.log_evidence)
