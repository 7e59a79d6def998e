"""The regions of cloth and panel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.block import Block
from diagnosis.measurement.reference import CELLS
from diagnosis.report import Region

Array = NDArray[np.float64]
REGIONS: tuple[Region, ...] = ("pins", "top_edge", "sides", "hem", "interior", "panel", "all")
PIN_SHARE = 0.17
"""Cells whose middle is within this share of the sample of a pinned corner belong to the pins."""


def region_of_cells(scene: str, centre: Array) -> dict[Region, NDArray[np.bool_]]:
    """Which of the cells (cloth, then ring) belong to each region, bool [cells]."""
    corners = [(0.0, 0.0), (1.0, 0.0)] + ([(1.0, 1.0)] if scene == "stretch" else [])
    near = np.zeros(len(centre), dtype=bool)
    for corner in corners:
        near |= np.linalg.norm(centre - np.asarray(corner), axis=1) < PIN_SHARE
    ring = np.arange(len(centre)) >= CELLS * CELLS
    cloth = ~ring & ~near
    u, v = centre[:, 0], centre[:, 1]
    edge = 1.5 / CELLS
    top, hem = cloth & (v < edge), cloth & (v > 1 - edge)
    side = cloth & ~top & ~hem & ((u < edge) | (u > 1 - edge))
    masks: dict[Region, NDArray[np.bool_]] = {
        "pins": near & ~ring,
        "top_edge": top,
        "sides": side,
        "hem": hem,
        "interior": cloth & ~top & ~hem & ~side,
        "panel": ring,
        "all": np.ones(len(centre), dtype=bool),
    }
    return masks


def region_directions(block: Block, centre: Array) -> dict[Region, Array]:
    """The measurements of each region that were seen, as orthonormal rows, [in the region, n].

    Args:
        block: ``n`` measurements.
        centre: of the cells, in units of the sample, [cells + ring, 2].
    """
    masks = region_of_cells(block.scene, centre)
    every = np.eye(len(block.cell))
    return {region: every[masks[region][block.cell]] for region in REGIONS}
