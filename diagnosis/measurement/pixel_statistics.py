"""Statistics of the pixels themselves: noise, its correlation, steps, holes, mixed edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from diagnosis.measurement.reference import Reference

LEAST_STEP_M = 0.0005
"""Depth values nearer to each other than this count as continuous."""
LEAST_NOISE_M = 0.0001
"""Less noise counts as this much: simulations of one cloth differ by as much."""
LEAST_PIXELS = 500
BLOCK, LEAST_BLOCKS = 8, 30
"""Edge of the blocks of pixels in which noise is looked for, and how many of them are needed."""
CALM = 0.25
"""Share of the blocks that are the calmest."""
CALM_FAR, CALM_NEAR = 1.090, 1.709
"""Mean squares of white noise of variance 1 in them, of differences of pixels two and one apart."""
DITHERED = 0.4
"""Noise of so much of a step hides the steps."""
EDGE_M = 0.012
EDGE_NOISES = 7.0
"""A depth edge is larger than this length and than so many standard deviations of the noise."""
PIXEL_NAMES = ("log_noise", "correlation", "log_step", "dropout", "edge_mix", "edge_blur", "edge_ragged")


def pixel_statistics(depth: NDArray[np.float32], reference: Reference) -> NDArray[np.float64]:
    """Measured on smooth places of cloth and panel, and at the reference's depth edges.

    Returns:
        float64 [7]: log of the noise [m] in the difference between pixels two apart, at least
        :data:`LEAST_NOISE_M`; correlation of neighbouring
        pixels' noise; log of the distance between depth values that occur [m], at least
        :data:`LEAST_STEP_M`; share of pixels without data among those inside what is shown; share of
        edge pixels between the two sides; mean absolute difference at edges, as a share of the step; mean change of
        that mixture from one pixel to the next along the edge (a blur mixes evenly, stray pixels do not). NaN where
        too little is seen.
    """
    known = depth > 0
    smooth = (reference.depth > 0) & ~reference.edge
    difference = np.where(known, depth.astype(np.float64) - reference.depth, np.nan)
    difference[~smooth] = np.nan
    out = np.full(len(PIXEL_NAMES), np.nan)
    out[2] = _step(depth[known & smooth])
    out[0], out[1] = _noise(difference, float(np.exp(out[2])))
    expected = (reference.depth > 0) & ~_outside(known, reference)
    if expected.any():
        out[3] = np.count_nonzero(expected & ~known) / np.count_nonzero(expected)
    noise = float(np.exp(out[0])) if np.isfinite(out[0]) else 0.0
    out[4:] = _edges(depth, max(EDGE_M, EDGE_NOISES * noise))
    return out


def _outside(known: NDArray[np.bool_], reference: Reference) -> NDArray[np.bool_]:
    """Pixels round everything that the picture shows: beyond the panel's border or, without a panel, the cloth's.

    They are no holes. Single pixels without data at a full picture's rim are.
    """
    if known.all():
        return np.zeros_like(known)
    outside = ~ndimage.binary_fill_holes(known)
    return ndimage.binary_opening(outside, iterations=2) if reference.panel.any() else np.asarray(outside)


def _noise(difference: NDArray[np.float64], step_m: float) -> tuple[float, float]:
    """Log standard deviation of the high-frequency part and the correlation of neighbours.

    Taken where the picture is calmest, in blocks of pixels: elsewhere what the cloth's own shape differs by looks like
    noise. Where steps are coarser than the noise, calm blocks lie between two steps and tell nothing: there everything
    counts.
    """
    far = difference[:, 2:-2] - 0.5 * (difference[:, :-4] + difference[:, 4:])
    near = difference[:, 1:] - difference[:, :-1]
    if np.count_nonzero(np.isfinite(far)) < LEAST_PIXELS or np.count_nonzero(np.isfinite(near)) < LEAST_PIXELS:
        return float("nan"), float("nan")
    variances = _in_calm_blocks(far, near[:, 1:-2])
    coarse = step_m > 1.01 * LEAST_STEP_M
    if variances is None or (coarse and variances[0] < (DITHERED * step_m) ** 2):
        variances = _everywhere(far) / 1.5, _everywhere(near) / 2.0
    variance_far, variance_near = variances
    if variance_far <= LEAST_NOISE_M**2:
        return float(np.log(LEAST_NOISE_M)), 0.0
    return 0.5 * float(np.log(variance_far)), 1.0 - variance_near / variance_far


def _in_calm_blocks(far: NDArray[np.float64], near: NDArray[np.float64]) -> tuple[float, float] | None:
    """Variances of the noise from differences of pixels two and one apart, [H, W]; None where too little is seen."""
    by_block = [_block_means(square) for square in (far**2, near**2)]
    usable = np.isfinite(by_block[0]) & np.isfinite(by_block[1])
    if np.count_nonzero(usable) < LEAST_BLOCKS:
        return None
    seen_far, seen_near = (means[usable] for means in by_block)
    calm = seen_far <= np.quantile(seen_far, CALM)
    return float(seen_far[calm].mean()) / CALM_FAR, float(seen_near[calm].mean()) / CALM_NEAR


def _block_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over square blocks; NaN in those with fewer than half of their pixels."""
    rows, columns = (size // BLOCK * BLOCK for size in values.shape)
    parts = values[:rows, :columns].reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK)
    known = np.isfinite(parts)
    count = known.sum(axis=(1, 3))
    total = np.where(known, parts, 0.0).sum(axis=(1, 3))
    return np.where(2 * count >= BLOCK * BLOCK, total / np.maximum(count, 1), np.nan)


def _everywhere(values: NDArray[np.float64]) -> float:
    """Mean square of all, a few in a thousand cut at either end."""
    seen = values[np.isfinite(values)]
    return float(np.mean(np.clip(seen, *np.quantile(seen, [0.002, 0.998])) ** 2))


def _step(values: NDArray[np.float32]) -> float:
    """Log of the median gap between neighbouring depth values that occur."""
    if values.size < 500:
        return float("nan")
    low, high = np.quantile(values, [0.02, 0.98])
    present = np.unique(np.round(values[(values >= low) & (values <= high)], 6))
    gaps = np.diff(present)
    gaps = gaps[gaps > 2e-6]
    return float(np.log(max(LEAST_STEP_M, np.median(gaps)))) if gaps.size >= 3 else float("nan")


def _edges(depth: NDArray[np.float32], least_m: float) -> tuple[float, float, float]:
    """How pixels behave at the picture's own depth edges larger than ``least_m``."""
    counts = [0, 0]
    widths, changes = [], []
    for z in (depth, depth.T):
        left, middle, right = z[:, :-4], z[:, 2:-2], z[:, 4:]
        inner, outer = z[:, 1:-3], z[:, 3:-1]
        seen = (left > 0) & (middle > 0) & (right > 0) & (inner > 0) & (outer > 0)
        jump = right - left
        edge = seen & (np.abs(jump) > least_m)
        if not edge.any():
            continue
        mixture = np.where(edge, (middle - left) / np.where(edge, jump, 1.0), np.nan)
        share = mixture[edge]
        between = (share > 0.2) & (share < 0.8)
        change = np.abs(np.diff(np.clip(mixture, -0.5, 1.5), axis=0))
        changes.append(change[np.isfinite(change)])
        counts[0] += int(np.count_nonzero(between))
        counts[1] += int(np.count_nonzero(edge))
        widths.append(np.abs(outer[edge] - inner[edge]) / np.abs(jump[edge]))
    along = np.concatenate(changes) if changes else np.zeros(0)
    if counts[1] < 60 or len(along) < 30:
        return float("nan"), float("nan"), float("nan")
    return counts[0] / counts[1], float(np.mean(np.concatenate(widths))), float(np.mean(along))
