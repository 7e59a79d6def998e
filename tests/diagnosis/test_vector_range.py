"""The range of a vector's length beside its fit: made-up Gaussians, and made-up measurements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import ncx2

from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.inference.evidence import _known, _of_vector, tabulate, tabulate_nothing
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.pairs import _pairs
from diagnosis.inference.subtract import without
from diagnosis.inference.vector_range import at_lengths, into_range
from diagnosis.simulation.sizes import fading, node_values, vector_step
from tests.diagnosis.response_rows import random_rows
from tests.diagnosis.test_evidence import COUNT, FABRICS, a_set

MOVED = get_effect("camera_translation")
RANGE = next(iter(MOVED.components.values()))
PRIOR_SIGMA = 1.2 * vector_step(MOVED) / np.sqrt(3)


def mean_fall(length: float, sigma: float) -> float:
    """Log mean of the prior's fall over a round Gaussian this far from zero, by its length's own distribution."""
    lengths = np.linspace(1e-5, 0.04, 200_000)
    density = ncx2.logpdf((lengths / sigma) ** 2, 3, (length / sigma) ** 2) + np.log(2.0 * lengths / sigma**2)
    return float(logsumexp(density + fading(RANGE, lengths)) + np.log(lengths[1] - lengths[0]))


@pytest.mark.parametrize(
    ("length", "sigma"),
    [
        (0.001, 0.002), (0.002, 0.0005), (0.002, 0.0002), (0.001, 0.0003), (0.0029, 0.0001), (0.005, 0.0003),
        (0.013, 0.001), (0.016, 0.0005), (1e-9, PRIOR_SIGMA),
    ],
)  # fmt: skip
def test_the_fall_of_the_prior_is_integrated_over_the_fit(length: float, sigma: float) -> None:
    """At the fitted size alone it would be -27 for -0.36 in the first, and without bound in the last."""
    direction = np.array([2.0, -1.0, 2.0]) / 3.0
    size, fall = into_range(MOVED, length * direction, np.eye(3) / sigma**2)
    assert fall == pytest.approx(mean_fall(length, sigma), abs=0.05)
    assert RANGE.low * 0.6 < np.linalg.norm(size) < RANGE.high * 1.4
    if RANGE.low < length < RANGE.high:
        np.testing.assert_array_equal(size, length * direction)


def test_the_likeliest_vector_of_a_length_goes_where_the_fit_is_soft() -> None:
    hessian = np.diag([1e8, 1e6, 1e8])
    centre = np.array([1e-3, 0.0, -5e-4])
    found = at_lengths(centre, hessian, np.array([2e-3, 4e-3]))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), [2e-3, 4e-3])
    angles = np.random.default_rng(3).standard_normal((20_000, 3))
    for length, one in zip((2e-3, 4e-3), found, strict=True):
        others = length * angles / np.linalg.norm(angles, axis=1)[:, None] - centre
        least = np.einsum("ni,ij,nj->n", others, hessian, others).min()
        assert (one - centre) @ hessian @ (one - centre) <= least * (1.0 + 1e-6)
    shrunk = at_lengths(centre, hessian, np.array([5e-4]))[0]
    assert np.linalg.norm(shrunk) == pytest.approx(5e-4) and shrunk[0] > 0.0 > shrunk[2]


def with_camera(shown: float, move: Callable[[int], np.ndarray]) -> tuple[list[Block], PixelBlock]:
    """Four fabrics seen by a camera whose typical move changes each measurement by ``shown`` errors or so."""
    rng = np.random.default_rng(7)
    blocks, pixels = a_set("off_grain", {"value": 6.0}, range(0))
    rows = [random_rows(rng, MOVED.name, shown, COUNT) for _ in range(FABRICS)]
    for fabric, (block, own) in enumerate(zip(blocks, rows, strict=True)):
        measured = block.stated.measured + move(fabric) @ own[:3] / vector_step(MOVED)
        view = replace(block.stated, measured=measured, responses=block.stated.responses | {MOVED.name: own})
        blocks[fabric] = replace(block, stated=view, wide=view)
    still = {MOVED.name: np.zeros((6, 1))}
    return blocks, replace(pixels, responses=pixels.responses | still)


def test_a_move_that_captures_cannot_show_is_as_probable_as_none() -> None:
    blocks, pixels = with_camera(1e-6, lambda fabric: np.zeros(3))
    model = LikelihoodModel()
    none = tabulate_nothing(blocks, pixels, model)
    table = tabulate(MOVED, blocks, pixels, model)
    gained = sum(float(value.sum()) for value in table.blocks) - sum(float(value.sum()) for value in none.blocks)
    assert gained + float(table.prior[0]) == pytest.approx(0.0, abs=0.15)
    assert RANGE.low <= np.linalg.norm(list(table.sizes[0].values())) <= RANGE.high


def test_a_move_that_shows_a_little_is_weighed_as_its_integral() -> None:
    """Against the same likelihood summed over sizes drawn from the prior."""
    blocks, pixels = with_camera(0.3, lambda fabric: np.array([0.002, -0.003, 0.002]))
    model = LikelihoodModel()
    known, rng = _known(blocks, MOVED.name), np.random.default_rng(5)
    sizes = PRIOR_SIGMA * rng.standard_normal((4000, 3))
    falls = fading(RANGE, np.linalg.norm(sizes, axis=1))
    logs = [float(_of_vector(MOVED, size, known, pixels, model)[0].sum()) for size in sizes]
    exact = float(logsumexp(np.array(logs) + falls) - np.log(len(sizes)))
    table = tabulate(MOVED, blocks, pixels, model)
    told = sum(float(value.sum()) for value in table.blocks) + float(table.pixels.sum()) + float(table.prior[0])
    assert told == pytest.approx(exact, abs=1.5)


def test_a_pair_costs_what_its_moved_camera_costs_beside_the_second() -> None:
    """Alone it is fitted less sharply, and shorter, since the second effect takes part of it back."""
    blocks, pixels = with_camera(6.0, lambda fabric: np.array([0.004, 0.0, 0.0]))
    off, model = get_effect("off_grain"), LikelihoodModel()
    for fabric, block in enumerate(blocks):
        own = 3.0 * np.random.default_rng(fabric).standard_normal(COUNT)
        back = own - 0.4 * block.stated.responses[MOVED.name][0]
        rows = np.outer(np.array(node_values(off)) / max(node_values(off)), back)
        responses = block.stated.responses | {off.name: rows}
        view = replace(block.stated, measured=block.stated.measured + back, responses=responses)
        blocks[fabric] = replace(block, stated=view, wide=view)
    still = {off.name: np.zeros((len(node_values(off)), 1))}
    pixels = replace(pixels, responses=pixels.responses | still)
    nothing = tabulate_nothing(blocks, pixels, model)
    alone = tabulate(MOVED, blocks, pixels, model)
    evidence = {MOVED.name: alone.weigh(blocks, [float(value.max()) for value in alone.blocks], model)}
    names = [MOVED.name, off.name]
    ((_, sizes, table),) = _pairs(names[:1], names, blocks, pixels, model, evidence, nothing)
    left = [without(block, off.name, sizes[off.name]) for block in blocks]
    beside = tabulate(MOVED, left, pixels, model)
    plain = tabulate(off, [without(b, MOVED.name, sizes[MOVED.name]) for b in blocks], pixels, model, as_simulated=True)
    cost = table.prior - plain.prior
    assert abs(float(alone.prior[0]) - float(beside.prior[0])) > 2.0
    np.testing.assert_allclose(cost, float(beside.prior[0]), atol=1.0)
