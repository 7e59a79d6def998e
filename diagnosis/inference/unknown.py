"""How well something that no effect describes explains the captures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.block import Block, PixelBlock, whiten
from diagnosis.inference.evidence import Table, tabulate_nothing
from diagnosis.inference.likelihood import LikelihoodModel, pixel_unknown
from diagnosis.inference.scatter import Scatter, widened
from diagnosis.inference.smooth_modes import smooth_modes

Array = NDArray[np.float64]
UNKNOWN_FACTORS = np.geomspace(1.5, 30.0, 13)
"""By how much all errors are larger than modelled when something unknown is there."""
UNKNOWN_SHAPES_M = np.geomspace(0.004, 0.016, 3)
"""Root mean square of a smooth change that nothing describes [m]; simulators differ by 1 mm for no reason at all."""
MOST_OF_A_BLOCK = 4.0
"""Log likelihood that such a change may gain in one block: one fabric in other folds is not yet something unknown."""
NUMBERS_SHARE = 0.1
"""Of ``unknown``: some of the shared numbers are off; the catalogue has an effect for each of them alone."""
LARGER_SHARE = 0.5
"""Of ``unknown``: errors larger than modelled all over; the rest are smooth changes."""


def tabulate_unknown(blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Table:
    """Of something that no effect describes: in the shape (all blocks off by one factor), in the pixels or in both."""
    nothing = tabulate_nothing(blocks, pixels, model)
    wild = pixel_unknown(pixels, model)
    calm = float(nothing.pixels[0])
    values = []
    for block, still in zip(blocks, nothing.blocks, strict=True):
        shapes = np.minimum(unknown_shape(block, model), still + MOST_OF_A_BLOCK)
        forms = np.concatenate([_larger_errors(block, model), shapes])
        values.append(np.concatenate([forms, forms, still]))
    kinds = (len(UNKNOWN_FACTORS), len(UNKNOWN_SHAPES_M))
    seen = np.concatenate([np.full(sum(kinds), calm), np.full(sum(kinds) + 1, wild)])
    form = np.repeat([LARGER_SHARE, 1.0 - LARGER_SHARE], kinds) / np.repeat(kinds, kinds)
    share = 0.5 * NUMBERS_SHARE
    prior = np.log(np.concatenate([form * (1.0 - NUMBERS_SHARE), form * share, [share]]))
    return Table("unknown", tuple(values), seen, prior, ({},) * len(prior))


def without_repeated(unknown: Table, nothing: Table, nats: float) -> Table:
    """Less what shared numbers that are off say only again.

    Args:
        unknown, nothing: tables of both.
        nats: see :class:`diagnosis.inference.something_beside.Beside`.
    """
    wild = unknown.pixels > nothing.pixels.max()
    return replace(unknown, pixels=np.where(wild, unknown.pixels - nats, unknown.pixels))


def _larger_errors(block: Block, model: LikelihoodModel) -> Array:
    """Of a block whose errors are larger than modelled by each of :data:`UNKNOWN_FACTORS`, whatever their direction."""
    view = block.stated
    dimension = len(view.measured) * model.dimension_share
    square = float(view.measured @ view.measured) * model.dimension_share
    density = model.log_density(square / UNKNOWN_FACTORS**2, dimension, block.scene)
    return np.asarray(density - dimension * np.log(UNKNOWN_FACTORS) - model.dimension_share * view.log_det)


def unknown_shape(block: Block, model: LikelihoodModel) -> Array:
    """Of a block with a smooth change of the cloth that is the same in all repeats, whatever its form.

    One value for each root mean square of :data:`UNKNOWN_SHAPES_M`; the repeats agree as well as modelled, which
    larger errors all over do not grant.
    """
    view = block.stated
    shapes = Scatter.along(whiten(view, smooth_modes()[block.cell]).T, UNKNOWN_SHAPES_M)
    return widened(view, shapes, block.scene, model)
