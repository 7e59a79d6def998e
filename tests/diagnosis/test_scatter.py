"""An effect that is another in every repeat, on measurements made up for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.inference.evidence import tabulate, tabulate_nothing
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.scatter import SCATTER_LEFT, UNSPANNED, Scatter, widened, with_scatter
from diagnosis.inference.smooth_modes import smooth_modes
from diagnosis.measurement.reference import CELLS
from diagnosis.simulation.sizes import node_values

COUNT, REPEATS, FABRICS = CELLS * CELLS, 2, 4
EFFECT = get_effect("bending_hysteresis")
SIMULATED = node_values(EFFECT)[0]
QUIET = PixelBlock(np.zeros(1), {EFFECT.name: np.zeros((len(EFFECT.places), 1))}, sensor_known=False)


def fabrics(size: float, *, shared: bool = False, errors: float = 1.0) -> list[Block]:
    """Fabrics in ``stretch`` whose repeats show random changes of this size, or all the same one.

    They are smooth but for as much as those are that are simulated (:data:`UNSPANNED`). Errors are so large [0.3 mm, as
    which they are modelled]; the simulated draws are five times that. A part of what the effect gives is left to be
    seen (:data:`SCATTER_LEFT`).
    """
    rng = np.random.default_rng(5)
    modes = smooth_modes()[:COUNT] / np.sqrt(np.mean(np.sum(smooth_modes()[:COUNT] ** 2, axis=1)))
    blocks = []
    for fabric in range(FABRICS):
        smooth = (modes @ rng.standard_normal((modes.shape[1], 3 + REPEATS))).T
        rough = rng.standard_normal((3 + REPEATS, COUNT))
        draws = 5.0 * (np.sqrt(1.0 - UNSPANNED) * smooth + np.sqrt(UNSPANNED) * rough)
        seen = np.repeat(draws[-1:], REPEATS, axis=0) if shared else draws[3:]
        measured = (SCATTER_LEFT * size / SIMULATED * seen + errors * rng.standard_normal((REPEATS, COUNT))).ravel()
        rows = np.concatenate([np.kron(np.eye(REPEATS)[k], draws[:3]) for k in range(REPEATS)])
        view = View(measured, {}, {EFFECT.name: rows}, 3e-4 * np.eye(REPEATS * COUNT), 0.0)
        owner, cell = np.repeat(np.arange(REPEATS), COUNT), np.tile(np.arange(COUNT), REPEATS)
        none = np.zeros((0, REPEATS * COUNT))
        blocks.append(Block(f"f{fabric}", "stretch", ("a", "b"), view, view, cell, owner, none, none, none))
    return blocks


def gain(blocks: list[Block]) -> tuple[float, float]:
    """Log evidence over that of nothing, and the most probable size."""
    model = LikelihoodModel()
    nothing = tabulate_nothing(blocks, QUIET, model)
    best = [float(value.max()) for value in nothing.blocks]
    found = tabulate(EFFECT, blocks, QUIET, model).weigh(blocks, best, model)
    return found.log_evidence - nothing.weigh(blocks, best, model).log_evidence, found.size[SCALAR]


@pytest.mark.parametrize("size", [7.0, 14.0])
def test_repeats_that_scatter_give_the_size_of_what_scatters_them(size: float) -> None:
    nats, fitted = gain(fabrics(size))
    assert nats > 3.0
    assert fitted == pytest.approx(size, rel=0.3)


def test_repeats_that_agree_show_no_scatter() -> None:
    assert gain(fabrics(0.0))[0] < 0.0
    assert gain(fabrics(14.0, shared=True))[0] < gain(fabrics(14.0))[0] - 10.0


def test_repeats_may_share_what_all_draws_share() -> None:
    """Strong random curvature stiffens cloth, so its draws have something in common, and so have repeats."""
    rng = np.random.default_rng(8)
    alike = 10.0 * smooth_modes()[:COUNT] @ rng.standard_normal(smooth_modes().shape[1])
    shown = [with_mean(block, alike) for block in fabrics(14.0)]
    unknown = [with_mean(block, 0.0 * alike, alike) for block in fabrics(14.0)]
    assert gain(shown)[0] > gain(unknown)[0] + 3.0


def with_mean(block: Block, drawn: np.ndarray, seen: np.ndarray | None = None) -> Block:
    """A block whose draws, and whose captures by a half of it, have something in common, [cells] in standard errors."""
    measured = block.stated.measured + 0.5 * np.tile(drawn if seen is None else seen, REPEATS)
    rows = block.stated.scatter[EFFECT.name] + np.kron(np.repeat(np.eye(REPEATS), 3, axis=0), drawn)
    view = replace(block.stated, measured=measured, scatter={EFFECT.name: rows})
    return replace(block, stated=view, wide=view)


def test_scatter_counts_in_hanging_where_there_is_nothing_else() -> None:
    stretch = fabrics(7.0)
    hanging = [replace(block, scene="hanging") for block in stretch]
    size = {SCALAR: 7.0} | dict(EFFECT.places[0])
    alone = with_scatter(hanging, EFFECT.name, size)
    both = with_scatter([*stretch, *hanging], EFFECT.name, size)
    assert all(new.stated.log_det > old.stated.log_det for new, old in zip(alone, hanging, strict=True))
    assert all(new is not old for new, old in zip(both[:FABRICS], stretch, strict=True))
    assert all(new is old for new, old in zip(both[FABRICS:], hanging, strict=True))


def test_small_smooth_errors_are_no_scatter() -> None:
    """What is left beside so many directions is then far smaller than modelled, which is nobody's merit."""
    assert gain(fabrics(4.0, errors=0.3))[0] < 0.0


def test_weak_scatter_costs_nothing_where_errors_are_small() -> None:
    """It is held against nothing with errors of the same least scale."""
    model = LikelihoodModel()
    blocks = [replace(block, stated=weak(block.stated), wide=weak(block.wide)) for block in fabrics(0.0, errors=0.3)]
    nothing = tabulate_nothing(blocks, QUIET, model)
    for value, still in zip(tabulate(EFFECT, blocks, QUIET, model).blocks, nothing.blocks, strict=True):
        assert value == pytest.approx(np.full_like(value, still[0]), abs=0.1)


def weak(view: View) -> View:
    """With draws that change next to nothing."""
    return replace(view, scatter={name: 1e-3 * rows for name, rows in view.scatter.items()})


def test_what_changed_pixels_alone_took_nothing_away_from_the_shape() -> None:
    """Its response on the cloth is zero, and spans no direction."""
    model = LikelihoodModel()
    block = fabrics(0.0)[0]
    strange = block.stated.measured.copy()
    strange[0] = 30.0
    plain = replace(block.stated, measured=strange)
    scatter = Scatter.of(plain, block, EFFECT, np.array([1e-6]))
    taken = replace(plain, taken=(np.zeros(len(strange)),))
    found, expected = (widened(view, scatter, "stretch", model) for view in (taken, plain))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
