"""Is there a gap: captures against simulations with nothing added."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from diagnosis.gap.floor import repeat_squares
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.inference.cause import Cause
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.report import Gap

ALARM = 0.05
HANGING_DEGREES = 2.0
"""Folds that were not found make heavy tails."""
WEIGHTS = {"factor": 0.8, "shape": 0.1, "pixels": 0.1}
"""Shares of the alarm rate that the tests get."""


def detect(blocks: list[Block], pixels: PixelBlock, cause: Cause, model: LikelihoodModel) -> Gap:
    """Three tests; each p-value counts by the share of alarms that its test gets (weighted Bonferroni).

    Shape: each fabric's normalised squared difference in ``stretch`` (``hanging`` where there is none), by the (lower)
    median over fabrics, so that fabrics with wrong parameters or another fold raise no alarm. Pixels: their
    statistics. Factor: if nothing is there, the captures are more than b times as probable under other explanations in
    at most 1/b of cases (Markov's inequality), so one over that factor is a p-value.
    """
    scene = "stretch" if any(b.scene == "stretch" for b in blocks) else "hanging"
    chosen = [b for b in blocks if b.scene == scene]
    ratios = np.array([float(b.stated.measured @ b.stated.measured) / len(b.stated.measured) for b in chosen])
    dimension = max(1.0, model.dimension_share * float(np.median([len(b.stated.measured) for b in chosen])))
    ratio = float(np.quantile(ratios, 0.5, method="lower"))
    degrees = model.degrees if scene == "stretch" else HANGING_DEGREES
    p_shape = float(f_distribution.sf(ratio, dimension, degrees * len(chosen)))
    p_pixel = 1.0
    if len(pixels.measured):
        clipped = np.minimum(pixels.measured**2, 100.0)
        p_pixel = float(chi2.sf(float(clipped.sum()) / 2.0, len(clipped)))
    p_factor = float(np.exp(min(0.0, -cause.factor)))
    p = min(1.0, p_factor / WEIGHTS["factor"], p_shape / WEIGHTS["shape"], p_pixel / WEIGHTS["pixels"])
    metres = np.concatenate([b.metres(b.stated.measured) for b in chosen])
    repeats = [repeat_squares(b, b.metres(b.stated.measured)) for b in chosen]
    known = [square for square in repeats if square is not None]
    modelled = [float(np.mean(np.diag(b.stated.factor @ b.stated.factor.T))) for b in chosen]
    floor = np.mean(known or modelled)
    return Gap(
        detected=p < ALARM,
        p_value=p,
        value=1e3 * float(np.sqrt(np.mean(metres**2))),
        noise_floor=1e3 * float(np.sqrt(floor)),
        scene=scene,
        p_shape=p_shape,
        p_pixels=p_pixel,
        p_factor=p_factor,
    )
