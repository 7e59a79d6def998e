"""Pictures of what was found in a capture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from capture.prepare import PreparedCapture

_MARGIN_PX = 20


def draw_registration(prepared: PreparedCapture, path: Path) -> None:
    """Depth with the cloth's outline, and the registered height over the panel, side by side, as a PNG.

    Raises:
        InputError: the file cannot be written.
    """
    from io import BytesIO

    from matplotlib.figure import Figure

    from renderer.atomic import write_atomically

    window = _window(prepared.region.mask)
    depth = np.where(prepared.depth > 0.0, prepared.depth, np.nan)[window]
    mask, standing = _closed(prepared.region.mask)[window], _closed(prepared.region.standing)[window]
    seen = depth[mask & np.isfinite(depth)]
    near, far = np.percentile(seen, [0.5, 99.5])
    margin = 0.1 * (far - near) + 1e-3
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    picture = left.imshow(depth, vmin=near - margin, vmax=far + margin, cmap="viridis_r")
    left.contour(mask, levels=[0.5], colors="black", linewidths=0.8)
    left.contour(standing, levels=[0.5], colors="red", linewidths=0.8)
    left.set_title(
        f"{prepared.capture.id}: depth [m], cloth (black), measured as cloth (red)",
        fontsize=9,
        parse_math=False,  # an id may hold any character
    )
    figure.colorbar(picture, ax=left, shrink=0.85)
    height = np.where(prepared.network_input.mask, 1e3 * prepared.network_input.height, np.nan)
    picture = right.imshow(height, cmap="magma")
    right.set_title(f"height over the panel [mm], pose {prepared.registration.method.replace('_', ' ')}", fontsize=9)
    figure.colorbar(picture, ax=right, shrink=0.85)
    for axes in (left, right):
        axes.set_axis_off()
    content = BytesIO()
    figure.savefig(content, dpi=110, format="png")
    write_atomically(path, content.getvalue())


def _closed(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask without its pinholes, for outlines."""
    closed: NDArray[np.bool_] = ndimage.binary_closing(np.pad(mask, 4), iterations=3)[4:-4, 4:-4]
    return closed


def _window(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Rows and columns of the mask and a margin around it."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return (
        slice(max(0, rows[0] - _MARGIN_PX), rows[-1] + _MARGIN_PX + 1),
        slice(max(0, columns[0] - _MARGIN_PX), columns[-1] + _MARGIN_PX + 1),
    )
