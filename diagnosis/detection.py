"""Is there a gap: captures against simulations with nothing added."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from diagnosis.block import Block, PixelBlock
from diagnosis.likelihood import LikelihoodModel
from diagnosis.report import Gap

ALARM = 0.01


def detect(blocks: list[Block], pixels: PixelBlock, model: LikelihoodModel) -> Gap:
    """Robust statistic: each fabric's normalised squared difference in ``stretch`` (``hanging`` where there is none).

    Fabrics are combined by their median, so that one fabric with wrong parameters raises no alarm; the pixel
    statistics and the fabrics are two tests, the smaller p-value counts double (Bonferroni).
    """
    scene = "stretch" if any(b.scene == "stretch" for b in blocks) else "hanging"
    chosen = [b for b in blocks if b.scene == scene]
    ratios = np.array([float(b.stated.measured @ b.stated.measured) / len(b.stated.measured) for b in chosen])
    dimension = max(1.0, model.dimension_share * float(np.median([len(b.stated.measured) for b in chosen])))
    ratio = float(np.median(ratios))
    p_shape = float(f_distribution.sf(ratio, dimension, model.degrees * len(chosen)))
    p_pixel = 1.0
    if len(pixels.measured):
        clipped = np.minimum(pixels.measured**2, 100.0)
        p_pixel = float(chi2.sf(float(clipped.sum()) / 2.0, len(clipped)))
    p = min(1.0, 2.0 * min(p_shape, p_pixel))
    metres = np.concatenate([b.metres(b.stated.measured) for b in chosen])
    floor = np.concatenate([np.diag(b.stated.factor @ b.stated.factor.T) for b in chosen])
    return Gap(
        detected=p < ALARM,
        p_value=p,
        value=1e3 * float(np.sqrt(np.mean(metres**2))),
        noise_floor=1e3 * float(np.sqrt(np.mean(floor))),
        scene=scene,
        p_shape=p_shape,
        p_pixels=p_pixel,
    )
