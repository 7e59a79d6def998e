"""Connected surfaces of a depth picture: neighbours without a step between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture.holes import step_share
from capture.picture import Depth
from renderer.camera import Camera

_REACH_PX = 3
"""Neighbours up to this far apart in a row or column are joined, so that speckled pictures hold together [pixel]."""


def surfaces(depth: Depth, camera: Camera) -> tuple[NDArray[np.int32], int]:
    """Label the connected surfaces.

    Args:
        depth: z-depth [m], float32 [H, W], 0 = no data.
        camera: its camera.

    Returns:
        labels int32 [H, W], 0 where there is no data, and the number of labels.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    known = depth > 0.0
    node = np.full(depth.shape, -1, dtype=np.int64)
    node[known] = np.arange(int(known.sum()))
    step = step_share(camera) * depth
    pairs = []
    for reach in range(1, _REACH_PX + 1):
        for first, second in (
            ((slice(None), slice(None, -reach)), (slice(None), slice(reach, None))),
            ((slice(None, -reach), slice(None)), (slice(reach, None), slice(None))),
        ):
            joined = known[first] & known[second] & (np.abs(depth[first] - depth[second]) < step[first])
            pairs.append(np.stack([node[first][joined], node[second][joined]]))
    a, b = np.concatenate(pairs, axis=1)
    size = int(known.sum())
    graph = coo_matrix((np.ones(len(a), dtype=np.bool_), (a, b)), shape=(size, size))
    count, of_node = connected_components(graph, directed=False)
    labels = np.zeros(depth.shape, dtype=np.int32)
    labels[known] = of_node + 1
    return labels, int(count)
