"""Depth difference: needs no weights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metric.backends import Channel
from metric.render import DrapeRender, check_same_size


class DepthRmse:
    """Root mean square difference of the height over the panel [m], over the union of both silhouettes.

    Where only one of the two has cloth, the other is seen as the panel behind it.
    """

    name = "depth"
    channel = Channel.DEPTH
    unit = "m"
    fingerprint = "depth-rmse/1"

    def features(self, renders: Sequence[DrapeRender]) -> list[tuple[NDArray[np.float32], NDArray[np.bool_]]]:
        """Height [m] and silhouette of each render."""
        check_same_size([r.need_depth().shape for r in renders])
        return [(r.height, r.mask) for r in renders]

    def table(
        self,
        a: Sequence[tuple[NDArray[np.float32], NDArray[np.bool_]]],
        b: Sequence[tuple[NDArray[np.float32], NDArray[np.bool_]]],
    ) -> NDArray[np.float64]:
        """RMSE [m] of every pair, shape [len(a), len(b)]."""
        check_same_size([f[0].shape for f in (*a, *b)])
        heights_a, masks_a = _stack(a)
        heights_b, masks_b = _stack(b)
        squares = (
            np.sum(heights_a**2, axis=1)[:, None]
            + np.sum(heights_b**2, axis=1)[None, :]
            - 2.0 * heights_a @ heights_b.T
        )
        # |A or B| = |A| + |B| - |A and B|
        union = masks_a.sum(axis=1)[:, None] + masks_b.sum(axis=1)[None, :] - masks_a @ masks_b.T
        table: NDArray[np.float64] = np.sqrt(np.maximum(squares, 0.0) / union)
        return table


def _stack(
    features: Sequence[tuple[NDArray[np.float32], NDArray[np.bool_]]],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    heights = np.stack([f[0].ravel() for f in features]).astype(np.float64)
    masks = np.stack([f[1].ravel() for f in features]).astype(np.float64)
    return heights, masks
