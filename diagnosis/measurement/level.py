"""A capture's difference from a simulated picture with the panel's plane taken out.

A camera that is turned, or depths that are all off, tilt or shift the whole picture. That is measured on the panel, for
itself; what is left says how the cloth differs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.scene import SimulationScene
from renderer.depth import panel_depth

Array = NDArray[np.float64]
PLANE_PIXELS = 8000
"""About so many pixels of the panel are enough for its plane."""
LEAST_PIXELS = 500
"""Fewer say nothing of it."""
LEAST_KEPT = 0.5
"""Of a plane's pixels, at least so many are no outliers."""
ALIKE_M = 1e-4
"""Depths that differ by less are the same reading: finer than the steps of any depth camera."""


def panel_plane(difference: Array, panel: NDArray[np.bool_]) -> Array:
    """The plane of a picture's difference on the panel.

    Args:
        difference: [m], [H, W].
        panel: where both pictures show the panel, bool [H, W].

    Returns:
        Offset in the middle of the picture and change over half its width and half its height [m], [3]; NaN where too
        little of the panel is seen.
    """
    pixels = np.flatnonzero(panel)
    if len(pixels) <= LEAST_PIXELS:
        return np.full(3, np.nan)
    pixels = pixels[:: max(1, len(pixels) // PLANE_PIXELS)]
    rows, columns = _places(difference.shape)
    row, column = np.divmod(pixels, difference.shape[1])
    basis = np.stack([np.ones(len(pixels)), columns[0, column], rows[row, 0]], axis=1)
    return _robust_plane(basis, difference.ravel()[pixels])


def without_plane(difference: Array, plane: Array) -> Array:
    """A difference [m], [H, W], less a plane as :func:`panel_plane` gives it; unchanged by one that was not seen."""
    if not np.isfinite(plane).all():
        return difference
    rows, columns = _places(difference.shape)
    return np.asarray(difference - (plane[0] + plane[1] * columns + plane[2] * rows))


def levelled(depth: NDArray[np.float32], picture: NDArray[np.float32], scene: SimulationScene) -> Array:
    """How a capture differs from a scene's simulated picture, the panel's plane taken out [m], [H, W].

    NaN where one of the two shows nothing. Where no panel is seen it is the plain difference.
    """
    known = (depth > 0) & (picture > 0)
    difference = np.where(known, depth.astype(np.float64) - picture, np.nan)
    panel = known & (picture == panel_depth(scene.camera, scene.camera_from_panel))
    return without_plane(difference, panel_plane(difference, panel))


def _places(shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Of rows [H, 1] and columns [1, W], -1 to 1 across the picture."""
    return np.linspace(-1, 1, shape[0])[:, None], np.linspace(-1, 1, shape[1])[None]


def _robust_plane(basis: Array, values: Array) -> Array:
    """Least squares without what lies beyond four spreads, twice."""
    if not values.any():
        return np.zeros(3)
    keep = np.ones(len(values), dtype=bool)
    for _ in range(2):
        kept = basis[keep]
        plane = np.linalg.lstsq(kept, values[keep], rcond=None)[0]
        residual = values - basis @ plane
        spread = 1.4826 * float(np.median(np.abs(residual - np.median(residual)))) + 1e-6
        keep = np.abs(residual) < 4 * spread
        if keep.mean() < LEAST_KEPT:
            keep = _between_steps(residual)
    return np.asarray(plane)


def _between_steps(residual: Array) -> NDArray[np.bool_]:
    """What to keep of readings in steps coarser than the noise: most are alike, and the others are a step away."""
    away = np.abs(residual - np.median(residual))
    others = away[away > ALIKE_M]
    return np.asarray(away <= 4 * (float(np.median(others)) if len(others) else ALIKE_M))
