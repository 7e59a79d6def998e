"""Where the gap lies, as a picture: regions, smooth part and folds on the cloth's cells, stages."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.gap.kinds import kind_directions
from diagnosis.gap.regions import REGIONS, region_of_cells
from diagnosis.inference.block import Block
from diagnosis.measurement.reference import CELLS, cell_centres
from diagnosis.report import Kind, Region, RegionGap

Array = NDArray[np.float64]
SURE = 0.05
"""A row with a smaller adjusted p-value shows a difference."""
PLACES: Mapping[Region, tuple[float, float]] = MappingProxyType(
    {
        "pins": (2.2, 3.4),
        "top_edge": (6.5, 1.4),
        "sides": (2.2, 6.5),
        "interior": (8.4, 6.5),
        "hem": (5.5, 10.8),
        "panel": (6.5, 12.9),
    }
)
"""Where a region's numbers stand on its map, in cells, the panel's strip being one cell wide (column, row)."""


def where_picture(scene: str, blocks: Sequence[Block], rows: Sequence[RegionGap]) -> str:
    """One scene's rows and maps; PNG in base64.

    Args:
        scene: which.
        blocks: of all scenes.
        rows: of the report.
    """
    from matplotlib.figure import Figure

    own = [block for block in blocks if block.scene == scene]
    seen = [row for row in rows if row.scene == scene]
    figure = Figure(figsize=(17, 4), layout="constrained")
    axes: Any = figure.subplots(1, 4)
    _regions(figure, axes[0], scene, [row for row in seen if row.by == "region"])
    maps = {kind: kind_map(own, kind) for kind in ("low_order", "folds")}
    most = max(1.0, *(float(np.nanquantile(np.abs(values), 0.98)) for values in maps.values()))
    for axis, (kind, values) in zip(axes[1:3], maps.items(), strict=True):
        drawn = axis.imshow(values, vmin=-most, vmax=most, cmap="RdBu_r")
        axis.set_title(f"{kind}, mean of all captures [mm]\nnearer (red) or farther (blue)")
        axis.set_axis_off()
        figure.colorbar(drawn, ax=axis, shrink=0.8)
    _stages(axes[3], [row for row in seen if row.by == "stage"])
    return png_text(figure)


def kind_map(blocks: Sequence[Block], kind: Kind) -> Array:
    """Mean over all captures of one kind's part of the difference, positive where the capture is nearer [mm].

    Returns:
        [cells, cells], row by row down the sample; NaN where no capture sees the cloth.
    """
    total, count = np.zeros(CELLS * CELLS), np.zeros(CELLS * CELLS)
    for block in blocks:
        along = kind_directions(block, cell_centres())[kind]
        part = along.T @ (along @ block.metres(block.stated.measured))
        cloth = block.cell < CELLS * CELLS
        np.add.at(total, block.cell[cloth], -1e3 * part[cloth])
        np.add.at(count, block.cell[cloth], 1.0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1.0), np.nan).reshape(CELLS, CELLS))


def region_map(scene: str, rows: Sequence[RegionGap]) -> Array:
    """Gap over floor of each region on the cloth's cells with the panel's strip round them, [cells + 2, cells + 2]."""
    ratio = {row.region: row.gap / max(row.noise_floor, 1e-9) for row in rows}
    table = np.full((CELLS + 2, CELLS + 2), ratio.get("panel", np.nan))
    inner = np.full(CELLS * CELLS, np.nan)
    masks = region_of_cells(scene, cell_centres())
    for region in (name for name in REGIONS if name in ratio and name not in ("panel", "all")):
        inner[masks[region][: CELLS * CELLS]] = ratio[region]
    table[1:-1, 1:-1] = inner.reshape(CELLS, CELLS)
    return table


def _regions(figure: Any, axis: Any, scene: str, rows: Sequence[RegionGap]) -> None:
    drawn = axis.imshow(region_map(scene, rows), vmin=0.0, vmax=3.0, cmap="YlOrRd")
    for row in rows:
        if row.region in PLACES:
            sure = row.p_adjusted < SURE
            stage = f"\n{row.stage}" if sure and row.effect else ""
            axis.text(
                *PLACES[row.region],
                f"{row.region} {row.gap:.2f}/{row.noise_floor:.2f}{stage}",
                ha="center",
                va="center",
                fontsize=7,
                weight="bold" if sure else "normal",
                bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0},
            )
    axis.set_title("gap over noise floor [mm/mm]\nbold: adjusted p < 0.05")
    axis.set_axis_off()
    figure.colorbar(drawn, ax=axis, shrink=0.8)


def _stages(axis: Any, rows: Sequence[RegionGap]) -> None:
    places = np.arange(len(rows))
    colours = ["#c53030" if row.p_adjusted < SURE else "#a0aec0" for row in rows]
    axis.barh(places, [row.gap for row in rows], color=colours)
    axis.plot([row.noise_floor for row in rows], places, "k|", markersize=18)
    axis.set_yticks(places, [f"{row.stage}\n{row.effect}" for row in rows], fontsize=8)
    axis.invert_yaxis()
    axis.set_title("stage [standard deviations]\nred: adjusted p < 0.05; line: noise floor")


def png_text(figure: Any) -> str:
    """A matplotlib figure as PNG in base64."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=70)
    return base64.b64encode(content.getvalue()).decode()
