"""The gap region by region."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution
from scipy.stats import false_discovery_control

from diagnosis.block import Block
from diagnosis.reference import CELLS
from diagnosis.report import Region, RegionGap, StageName

REGIONS: tuple[Region, ...] = ("pins", "top_edge", "sides", "hem", "interior", "panel", "all")
PIN_SHARE = 0.17
"""Cells whose middle is within this share of the sample of a pinned corner belong to the pins."""


def region_of_cells(scene: str, centre: NDArray[np.float64]) -> dict[Region, NDArray[np.bool_]]:
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


def region_gaps(
    blocks: list[Block], centre: NDArray[np.float64], stage: StageName, degrees: float, dimension_share: float
) -> tuple[RegionGap, ...]:
    """Gap [mm], noise floor and p-value adjusted for the number of regions (Benjamini and Hochberg 1995).

    Args:
        blocks: all blocks.
        centre: of the cells, [cells, 2].
        stage: of the most probable explanation.
        degrees, dimension_share: of the noise model's t distribution.
    """
    rows: list[tuple[str, Region, float, float, float]] = []
    for scene in sorted({b.scene for b in blocks}):
        masks = region_of_cells(scene, centre)
        for region in REGIONS:
            squares, dimensions, metres, floors = 0.0, 0, [], []
            for block in (b for b in blocks if b.scene == scene):
                chosen = masks[region][block.cell]
                if not chosen.any():
                    continue
                covariance = (block.stated.factor @ block.stated.factor.T)[np.ix_(chosen, chosen)]
                residual = block.metres(block.stated.measured)[chosen]
                squares += float(residual @ np.linalg.solve(covariance, residual))
                dimensions += len(residual)
                metres.append(residual)
                floors.append(np.diag(covariance))
            if not dimensions:
                continue
            gap = 1e3 * float(np.sqrt(np.mean(np.concatenate(metres) ** 2)))
            floor = 1e3 * float(np.sqrt(np.mean(np.concatenate(floors))))
            p = float(f_distribution.sf(squares / dimensions, max(dimensions * dimension_share, 1.0), degrees))
            rows.append((scene, region, gap, floor, p))
    adjusted: list[float] = list(false_discovery_control([row[4] for row in rows])) if rows else []
    return tuple(
        RegionGap(scene=s, region=r, stage=stage, gap=gap, noise_floor=floor, p_adjusted=min(1.0, float(p)))
        for (s, r, gap, floor, _), p in zip(rows, adjusted, strict=True)
    )
