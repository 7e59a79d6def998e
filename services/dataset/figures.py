"""Pictures of a store: a contact sheet of depth pictures and the Spearman matrix of the fabrics."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from renderer.atomic import write_atomically
from renderer.picture import write_png
from renderer.store import Store
from simcore.errors import InputError
from simcore.parameters import PARAMETER_NAMES

CONTACT_COLUMNS = 8
CONTACT_ROWS = 6
LEAST_RELIEF_M = 0.03
"""Height over the farthest point that is shown white in the flattest pictures [m]."""


def write_figures(store: Store, folder: Path) -> list[Path]:
    """Write ``contact-sheet.png`` and ``spearman.png``.

    Raises:
        InputError: the store holds no usable sample, or the folder cannot be made.
    """
    if not store.ok.any():
        raise InputError(f"{store.url}: holds no usable sample yet, so there is nothing to show", code="store_empty")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror})", code="folder_not_writable") from None
    paths = [folder / "contact-sheet.png", folder / "spearman.png"]
    write_contact_sheet(store, paths[0])
    _, first = np.unique(store.materials[store.finished], return_index=True)
    write_spearman(store.parameters[store.finished][first], paths[1])
    return paths


def write_contact_sheet(store: Store, path: Path) -> None:
    """Up to 48 usable pictures, evenly over the store, light where the cloth is near; PNG."""
    usable = np.flatnonzero(store.ok)
    upright = usable[np.abs(store.inclination_deg[usable]) == np.abs(store.inclination_deg[usable]).min()]
    count = min(len(upright), CONTACT_COLUMNS * CONTACT_ROWS)
    chosen = upright[np.linspace(0, len(upright) - 1, count).round().astype(int)]
    columns = min(CONTACT_COLUMNS, count)
    height, width = (side // 2 for side in store.layout.picture_size)
    sheet = np.zeros((-(-count // columns) * height, columns * width), dtype=np.uint8)
    for place, sample in enumerate(chosen):
        row, column = divmod(place, columns)
        tile = relief(store.depth(int(sample)))[: 2 * height : 2, : 2 * width : 2]
        sheet[row * height : (row + 1) * height, column * width : (column + 1) * width] = tile
    write_png(path, sheet)


def relief(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Depth [m] as grey: the farthest point black, the nearest (at least 30 mm before it) white, uint8, same shape."""
    height = np.where(depth > 0, depth.max() - depth, 0.0)
    return (height / max(LEAST_RELIEF_M, float(height.max())) * 255).astype(np.uint8)


def write_spearman(parameters: NDArray[np.float32], path: Path) -> None:
    """Spearman rank correlations among the seven parameters, as the paper's figure; PNG.

    Args:
        parameters: one row a fabric, SI, shape [materials, 7].
        path: the file.
    """
    from matplotlib.figure import Figure

    matrix = spearman(parameters)
    figure = Figure(figsize=(7, 6), layout="constrained")
    axes = figure.add_subplot()
    image = axes.imshow(matrix, vmin=-1, vmax=1, cmap="RdBu_r")
    axes.set_xticks(range(len(PARAMETER_NAMES)), PARAMETER_NAMES, rotation=40, ha="right")
    axes.set_yticks(range(len(PARAMETER_NAMES)), PARAMETER_NAMES)
    for i, j in np.ndindex(matrix.shape):
        axes.text(j, i, f"{matrix[i, j]:.2f}", ha="center", va="center", color="w" if abs(matrix[i, j]) > 0.6 else "k")
    axes.set_title(f"Spearman correlation of {len(parameters)} fabrics")
    figure.colorbar(image)
    content = io.BytesIO()
    figure.savefig(content, dpi=110, format="png")
    write_atomically(path, content.getvalue())


def spearman(parameters: NDArray[np.float32]) -> NDArray[np.float64]:
    """Spearman rank correlations, float64, shape [7, 7]; NaN where a parameter does not vary."""
    from scipy.stats import rankdata

    ranks = rankdata(parameters, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.atleast_2d(np.corrcoef(ranks, rowvar=False))
