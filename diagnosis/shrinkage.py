"""How far the gap shrinks on captures that had no part in finding or fitting the effect."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.block import Block, PixelBlock
from diagnosis.cause import NOT_EFFECTS, Cause, name_cause
from diagnosis.effects import get_effect
from diagnosis.likelihood import LikelihoodModel
from diagnosis.report import Shrinkage
from diagnosis.subtract import response_to


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


def measure_shrinkage(
    cause: Cause, effects: tuple[str, ...], blocks: list[Block], pixels: PixelBlock, model: LikelihoodModel
) -> Shrinkage | None:
    """Two-fold over fabrics: each half is judged with the effect named and fitted on the other half.

    Returns:
        None when no effect is named or there is only one fabric.
    """
    fabrics = sorted({b.fabric for b in blocks})
    if cause.top in NOT_EFFECTS or len(fabrics) < 2:
        return None
    halves = (set(fabrics[::2]), set(fabrics[1::2]))
    before, after, floor = [], [], []
    held_out: list[str] = []
    for held, other in (halves, halves[::-1]):
        found = name_cause(effects, [b for b in blocks if b.fabric in other], pixels, model, pairs=len(cause.named) > 1)
        for block in (b for b in blocks if b.fabric in held):
            response = response_of(block, found)
            left, variance = refitted_residual(block, np.zeros_like(response))
            right, _ = refitted_residual(block, response)
            for number, capture in enumerate(block.captures):
                own = block.owner == number
                held_out.append(capture)
                before.append(float(np.mean(left[own] ** 2)))
                after.append(float(np.mean(right[own] ** 2)))
                floor.append(float(np.mean(variance[own])))
    squares = np.array([before, after, floor])
    fraction = _fraction(squares)
    rng = np.random.default_rng(0)
    draws = [_fraction(squares[:, rng.integers(0, len(before), len(before))]) for _ in range(400)]
    values = 1e3 * np.sqrt(np.median(squares, axis=1))
    return Shrinkage(
        held_out=tuple(sorted(held_out)),
        before=float(values[0]),
        after=float(values[1]),
        noise_floor=float(values[2]),
        fraction=fraction,
        interval_90=(float(np.quantile(draws, 0.05)), float(np.quantile(draws, 0.95))),
    )


def _fraction(squares: NDArray[np.float64]) -> float:
    before, after, floor = np.sqrt(np.median(squares, axis=1))
    floor = min(floor, after)
    return float(np.clip((before - after) / max(before - floor, 1e-9), -1.0, 1.0))
