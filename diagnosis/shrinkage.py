"""How far the gap shrinks on captures that had no part in finding or fitting the effect."""

from __future__ import annotations

from collections.abc import Callable, Set

import numpy as np
from numpy.typing import NDArray

from diagnosis.block import Block, PixelBlock
from diagnosis.cause import NOT_EFFECTS, Cause, name_cause
from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.likelihood import LikelihoodModel
from diagnosis.report import Shrinkage
from diagnosis.subtract import response_to

PLAIN = 3.0
"""Standard deviations beyond which a shared number shows an effect."""
PixelsOf = Callable[[Set[str]], PixelBlock]


def response_of(block: Block, cause: Cause) -> NDArray[np.float64]:
    """Whitened response of a block to the named effects at their fitted sizes, [n]."""
    total = np.zeros(len(block.stated.measured))
    for name in cause.named:
        if not get_effect(name).random_repeats:
            total = total + response_to(block.stated.responses, name, cause.size(name))
    return total


def refitted_residual(block: Block, response: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What is left in metres after the effect and the best parameters within their stated uncertainty; and its floor.

    Parameters are refitted by their posterior mean under the block's covariance.

    Returns:
        Residual [n] and expected variance of it without any effect [n], metres and m².
    """
    residual = block.metres(block.stated.measured - response)
    covariance = block.stated.factor @ block.stated.factor.T
    gain = block.jacobian.T @ block.jacobian @ np.linalg.solve(covariance, np.eye(len(residual)))
    left = residual - gain @ residual
    spread = np.eye(len(residual)) - gain
    return np.asarray(left), np.asarray(np.diag(spread @ covariance @ spread.T))


def repeat_squares(block: Block, values: NDArray[np.float64]) -> float | None:
    """Mean square by which repeats differ from their mean, cell by cell; None where there is one capture.

    Args:
        block: whose captures.
        values: residuals [m], [n].
    """
    count = len(block.captures)
    if count < 2:
        return None
    table = np.full((count, int(block.cell.max()) + 1), np.nan)
    table[block.owner, block.cell] = values
    everywhere = np.isfinite(table).all(axis=0)
    if not everywhere.any():
        return None
    return float(np.var(table[:, everywhere], axis=0, ddof=1).mean())


def measure_shrinkage(
    cause: Cause, effects: tuple[str, ...], blocks: list[Block], pixels_of: PixelsOf, model: LikelihoodModel
) -> Shrinkage | None:
    """Two-fold over fabrics: each half is judged with the effect named and fitted on the other half.

    Only ``stretch`` counts where there is any, as for the gap: ``hanging`` shows which folds fell rather than what is
    missing. What camera and sensor change is no shape: it is judged by the numbers that a set shares (pixel statistics,
    the panel's plane), in standard deviations, where they show it.

    Args:
        cause: found on all fabrics.
        effects: names that were tried.
        blocks: of all fabrics.
        pixels_of: pixel block of some fabrics, by their ids.
        model: see there.

    Returns:
        None when no effect is named or there is only one fabric.
    """
    fabrics = sorted({b.fabric for b in blocks})
    if cause.top in NOT_EFFECTS or len(fabrics) < 2:
        return None
    numbers = pixels_of(set(fabrics)).measured
    in_numbers = all(get_effect(name).stage in (Stage.CAMERA, Stage.SENSOR) for name in cause.named)
    in_numbers = in_numbers and len(numbers) > 0 and float(np.max(np.abs(numbers))) > PLAIN
    judged = [b for b in blocks if in_numbers or b.scene == "stretch"] or blocks
    halves = (set(fabrics[::2]), set(fabrics[1::2]))
    rows: list[tuple[float, float, float]] = []
    for held, other in (halves, halves[::-1]):
        train = [b for b in blocks if b.fabric in other]
        found = name_cause(effects, train, pixels_of(other), model, pairs=len(cause.named) > 1)
        if in_numbers:
            rows += [_pixel_row(pixels_of({fabric}), found) for fabric in sorted(held)]
        else:
            rows += [_shape_row(block, found) for block in judged if block.fabric in held]
    squares = np.array(rows).T
    rng = np.random.default_rng(0)
    draws = [_fraction(squares[:, rng.integers(0, len(rows), len(rows))]) for _ in range(400)]
    values = (1.0 if in_numbers else 1e3) * np.sqrt(np.mean(squares, axis=1))
    return Shrinkage(
        held_out=tuple(sorted(capture for block in judged for capture in block.captures)),
        before=float(values[0]),
        after=float(values[1]),
        noise_floor=float(values[2]),
        fraction=_fraction(squares),
        interval_90=(float(np.quantile(draws, 0.05)), float(np.quantile(draws, 0.95))),
        unit="standard deviations" if in_numbers else "mm",
    )


def _shape_row(block: Block, found: Cause) -> tuple[float, float, float]:
    """Mean squares before and after, and the floor's [m²]."""
    response = response_of(block, found)
    before, variance = refitted_residual(block, np.zeros_like(response))
    after, _ = refitted_residual(block, response)
    floor = repeat_squares(block, before)
    return float(np.mean(before**2)), float(np.mean(after**2)), float(np.mean(variance)) if floor is None else floor


def _pixel_row(pixels: PixelBlock, found: Cause) -> tuple[float, float, float]:
    """The same of the numbers that a set shares, in squares of their standard deviations."""
    left = pixels.measured
    for name in found.named:
        if not get_effect(name).random_repeats:
            left = left - response_to(pixels.responses, name, found.size(name))
    return float(np.mean(pixels.measured**2)), float(np.mean(left**2)), 1.0


def _fraction(squares: NDArray[np.float64]) -> float:
    """Share of the gap above the floor that goes away, by the root mean square over blocks."""
    before, after, floor = np.sqrt(np.mean(squares, axis=1))
    floor = min(floor, after)
    return float(np.clip((before - after) / max(before - floor, 1e-9), -1.0, 1.0))
