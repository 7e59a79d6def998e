"""Pictures of the demonstration, as PNG files."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from renderer.atomic import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PANEL_DEPTH_M = 0.9


def write_height_map(path: Path, depth: NDArray[np.float32]) -> None:
    """Write a depth picture [m], float32 [H, W] (0 = no data), as colours of the height over the panel."""
    figure = new_figure(4.6, 3.9)
    axes = figure.add_subplot()
    height_mm = np.where(depth > 0, (PANEL_DEPTH_M - depth) * 1e3, np.nan)
    shown = axes.imshow(height_mm, cmap="viridis", vmin=0.0)
    axes.set_axis_off()
    figure.colorbar(shown, ax=axes, label="height over the panel [mm]")
    save(figure, path)


def write_rows(
    path: Path,
    rows: Sequence[tuple[str, Sequence[str], Sequence[NDArray[np.uint8]]]],
) -> None:
    """Write rows of shaded pictures; each row is its label, its column labels and its pictures, uint8 [H, W]."""
    columns = len(rows[0][2])
    figure = new_figure(1.9 * columns, 2.15 * len(rows))
    for j, (label, names, pictures) in enumerate(rows):
        for i, (name, picture) in enumerate(zip(names, pictures, strict=True)):
            axes = figure.add_subplot(len(rows), columns, j * columns + i + 1)
            axes.imshow(picture, cmap="gray", vmin=0, vmax=255)
            axes.set_xticks([])
            axes.set_yticks([])
            axes.set_title(name, fontsize=8)
            if i == 0:
                axes.set_ylabel(label, fontsize=8)
    save(figure, path)


def write_matrix(path: Path, names: Sequence[str], values: NDArray[np.float64], title: str) -> None:
    """Write a square table of numbers, float64 [N, N], as colours with the numbers in them."""
    figure = new_figure(1.1 * len(names) + 1.6, 1.0 * len(names) + 0.9)
    axes = figure.add_subplot()
    axes.imshow(values, cmap="magma_r", vmin=0.0)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.set_title(title, fontsize=9)
    dark = 0.55 * float(values.max())
    for j, row in enumerate(values):
        for i, value in enumerate(row):
            axes.text(i, j, f"{value:.3g}", ha="center", va="center", color="white" if value > dark else "black")
    save(figure, path)


def new_figure(width: float, height: float) -> Figure:
    """A figure [inch] that needs no display."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=120, layout="constrained")


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    content = io.BytesIO()
    figure.savefig(content, format="png", metadata={"Software": None})
    write_atomically(path, content.getvalue())
