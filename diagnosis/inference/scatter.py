"""An effect that is another in every repeat: it widens the covariance of what is seen of a fabric.

Some random draws are simulated. They give the spread and its size; what other draws would give is a smooth change of
the same size, another one in every capture, and much that is not smooth. What all draws do alike all repeats show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from diagnosis.effect import SCALAR, Effect, Size
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, View, whiten
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.smooth_modes import smooth_modes
from diagnosis.inference.view_likelihood import Lengths
from diagnosis.simulation.sizes import node_values

Array = NDArray[np.float64]
FURTHER_DRAWS = 0.7
"""Root mean square of what further random draws give that the simulated ones do not span, of the latter's."""
UNSPANNED = 0.45
"""Of the squares of a simulated draw, whitened, what neither the others nor smooth changes give."""
SCATTER_LEFT = 0.7
"""Of the scatter that an effect gives, what is left between captures and the states that they themselves lead to."""
SCATTER_FREEDOM = 6.0
"""Degrees of freedom of a smooth random shape."""
RATIOS = 8.0
"""Width of the logarithm of what repeats share over how they differ, where something else than scatter is seen."""
NO_SPREAD = 1e-12
"""Variance along a direction, of the largest, that is rounding: draws about their mean span one direction less."""


@dataclass(frozen=True)
class Scatter:
    """What is added to a view's covariance at each of ``s`` sizes.

    Attributes:
        directions: whitened, [k, n].
        factors: the covariance grows by the square of these along the directions, [s].
        grown: by how much the variance of all errors grows, [s].
    """

    directions: Array
    factors: Array
    grown: Array

    @classmethod
    def of(cls, view: View, block: Block, effect: Effect, sizes: Array) -> Scatter:
        """An effect of some sizes, seen in one view of a block."""
        step, count = SCATTER_LEFT * np.abs(sizes) / node_values(effect)[0], len(block.owner)
        draws, alike = _scattered(view, block, effect.name)
        length = float(np.sqrt(np.sum((draws @ view.factor.T) ** 2) / count))
        further = FURTHER_DRAWS * length * whiten(view, _forms_of_each_capture(block)).T
        rough = 1.0 + UNSPANNED * step**2 * float(np.sum(draws**2)) / count
        return cls(np.concatenate([draws, further, alike[None]]), step, rough)

    @classmethod
    def along(cls, directions: Array, factors: Array) -> Scatter:
        """Nothing but these directions."""
        return cls(directions, factors, np.ones(len(factors)))


def _scattered(view: View, block: Block, name: str) -> tuple[Array, Array]:
    """What the simulated draws of an effect do, whitened: differently in each capture, [rows, n], and alike, [n].

    The former are a square root of the draws' covariance, the latter is their mean.
    """
    count = len(view.measured)
    draws = view.scatter[name].reshape(len(block.captures), -1, count)
    mean = draws.mean(axis=1)
    apart = (draws - mean[:, None]) / np.sqrt(max(1, draws.shape[1] - 1))
    return apart.reshape(-1, count), np.asarray(mean.sum(axis=0))


def widened(view: View, scatter: Scatter, scene: str, model: LikelihoodModel) -> Array:
    """Log likelihood of a block whose covariance grows, [s].

    Along what was taken away from it, that response's own uncertainty is all there is.
    """
    measured, count = view.measured, len(view.measured)
    taken = np.reshape(view.taken, (-1, count))
    known = Lengths.of((taken @ taken.T)[None], (taken @ measured)[None], count, model, alone=False)
    _, length, basis = np.linalg.svd(taken, full_matrices=False)  # what changes pixels alone took nothing away here
    along = basis[length > NO_SPREAD * max(float(length.max(initial=0.0)), NO_SPREAD)].T
    scale = float(np.sqrt(known.grown[0]))

    def apart(rows: Array) -> Array:
        return np.asarray((rows - (rows @ along) @ along.T) / scale)

    left, grown, rows = apart(measured), scatter.grown, apart(scatter.directions)
    spread, basis = np.linalg.eigh(rows @ rows.T)  # few rows: a tenth of the time of their singular values
    shown = spread > NO_SPREAD * spread.max(initial=0.0)
    spread, seen = spread[shown], basis.T[shown] @ (rows @ left) / np.sqrt(spread[shown])
    variance = grown[:, None] + np.outer(scatter.factors**2, spread)
    rest = max(0.0, float(left @ left) - float(seen @ seen)) / grown
    square = (rest + (seen**2 / variance).sum(axis=1)) * model.dimension_share + known.square[0]
    spent = 0.5 * np.log(variance).sum(axis=1) + 0.5 * (count - len(spread)) * np.log(grown)
    spent += view.log_det + 0.5 * count * np.log(known.grown[0])
    density = model.log_density(square, count * model.dimension_share, scene)
    return np.asarray(density - model.dimension_share * spent - known.spent[0])


def scattered_nats(block: Block) -> float:
    """Log odds that an effect which is another in every repeat makes what is seen, and not one that they share.

    The mean over repeats and their differences would have one variance: their ratio has an F distribution. If they
    share something, the ratio's logarithm is anything in :data:`RATIOS`. Repeats are those of one set-up: what effects
    do in another is another.
    """
    between, within, freedom = 0.0, 0.0, 0
    tables = block.repeats(block.metres(block.stated.measured))
    for table in tables:
        seen = table[:, np.isfinite(table).all(axis=0)]
        between += len(table) * float(np.mean(seen.mean(axis=0) ** 2))
        within += (len(table) - 1) * float(np.var(seen, axis=0, ddof=1).mean())
        freedom += len(table) - 1
    if not tables:
        return 0.0
    ratio = between / len(tables) / (within / freedom)
    seen_freedom = (SCATTER_FREEDOM * len(tables), SCATTER_FREEDOM * freedom)
    return float(f_distribution.logpdf(ratio, *seen_freedom) + np.log(ratio * RATIOS))


def shows_scatter(blocks: Sequence[Block]) -> list[bool]:
    """Which blocks count for an effect that is another in every repeat.

    Which folds fell in ``hanging`` looks like scatter and is none: it counts only where there is nothing else.
    """
    in_stretch = any(block.scene == "stretch" for block in blocks)
    return [block.scene == "stretch" or not in_stretch for block in blocks]


def with_scatter(blocks: Sequence[Block], name: str, size: Size) -> list[Block]:
    """Blocks whose errors hold an effect that is another in every repeat, of one size."""
    effect, sizes = get_effect(name), np.array([size[SCALAR]])
    found = []
    for block, shown in zip(blocks, shows_scatter(blocks), strict=True):
        if shown:
            stated, wide = (_with(view, Scatter.of(view, block, effect, sizes)) for view in block.views)
            block = replace(block, stated=stated, wide=wide)
        found.append(block)
    return found


def _with(view: View, scatter: Scatter) -> View:
    from scipy.linalg import solve_triangular

    rows = scatter.factors[0] * scatter.directions
    inner = np.linalg.cholesky(scatter.grown[0] * np.eye(rows.shape[1]) + rows.T @ rows)

    def again(values: Array) -> Array:
        return np.asarray(solve_triangular(inner, np.atleast_2d(values).T, lower=True).T)

    return View(
        again(view.measured)[0],
        {name: again(values) for name, values in view.responses.items()},
        {name: again(values) for name, values in view.scatter.items()},
        view.factor @ inner,
        view.log_det + float(np.log(np.diag(inner)).sum()),
        {key: again(values) for key, values in view.beside.items()},
        tuple(again(row)[0] for row in view.taken),
    )


def _forms_of_each_capture(block: Block) -> Array:
    """Smooth changes of each capture alone, [n, captures * forms]."""
    forms = smooth_modes()[block.cell]
    return np.concatenate([forms * (block.owner == k)[:, None] for k in range(len(block.captures))], axis=1)
