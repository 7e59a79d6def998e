"""Surfaces with known shapes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def height_field(
    height: Callable[[Array, Array], Array],
    x: tuple[float, float] = (-0.25, 0.25),
    y: tuple[float, float] = (-0.5, 0.0),
    cells: int = 100,
) -> tuple[Array, NDArray[np.int32]]:
    """Vertices (x, y, height(x, y)) of a square grid and its triangles, counter-clockwise from +z."""
    gx, gy = np.meshgrid(np.linspace(*x, cells + 1), np.linspace(*y, cells + 1))
    vertices = np.stack([gx, gy, height(gx, gy)], axis=-1).reshape(-1, 3)
    j, i = np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij")
    a = (j * (cells + 1) + i).ravel()
    b, c, d = a + 1, a + cells + 1, a + cells + 2
    return vertices, np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)]).astype(np.int32)


def drape_like(cells: int = 50, depth: float = 0.04) -> tuple[Array, NDArray[np.int32]]:
    """Something like hanging cloth: folds that grow towards the hem."""
    return height_field(lambda x, y: -depth * y * (1.2 + np.sin(30.0 * x)) * 2.0, x=(-0.2, 0.2), cells=cells)
