"""Silhouettes: how much of the outline two drapes share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metric.backends import Channel
from metric.render import DrapeRender, check_same_size


class SilhouetteIou:
    """1 - intersection over union of where the cloth is."""

    name = "silhouette"
    channel = Channel.DEPTH
    unit = ""
    fingerprint = "silhouette-iou/1"

    def features(self, renders: Sequence[DrapeRender]) -> list[NDArray[np.bool_]]:
        """Mask of each render, bool [H, W]."""
        check_same_size([r.need_depth().shape for r in renders])
        return [r.mask for r in renders]

    def table(self, a: Sequence[NDArray[np.bool_]], b: Sequence[NDArray[np.bool_]]) -> NDArray[np.float64]:
        """1 - IoU of every pair, shape [len(a), len(b)]."""
        check_same_size([f.shape for f in (*a, *b)])
        first = np.stack([m.ravel() for m in a]).astype(np.float64)
        second = np.stack([m.ravel() for m in b]).astype(np.float64)
        common = first @ second.T
        table: NDArray[np.float64] = 1.0 - common / (first.sum(1)[:, None] + second.sum(1)[None, :] - common)
        return table
