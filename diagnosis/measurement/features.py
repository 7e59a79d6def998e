"""What is measured on a depth picture: its difference from a reference, on cloth and panel, and pixel statistics.

The same function measures captures and simulated pictures, so that what an effect does to a feature is measured the way
the capture's is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.measurement.level import panel_plane, without_plane
from diagnosis.measurement.pixel_statistics import PIXEL_NAMES, pixel_statistics
from diagnosis.measurement.reference import Reference


@dataclass(frozen=True)
class Features:
    """Measurements on one picture against one reference.

    Attributes:
        shape: mean difference in each cell after the panel's plane was taken out [m], [cells + ring]; NaN: not seen.
        plane: offset in the middle of the picture and change over half its width and height of the panel's difference
            [m], [3]; NaN without a panel.
        pixels: see :data:`diagnosis.measurement.pixel_statistics.PIXEL_NAMES`; NaN where it cannot be measured.
        weight: pixels of each cell, [cells + ring].
    """

    shape: NDArray[np.float64]
    plane: NDArray[np.float64]
    pixels: NDArray[np.float64]
    weight: NDArray[np.float64]

    def vector(self) -> NDArray[np.float64]:
        """Shape then plane, [cells + ring + 3]."""
        return np.concatenate([self.shape, self.plane])

    def pixel_variance(self, log_noise: float) -> np.float64:
        """Of a pixel, by the noise that was measured [m²].

        Args:
            log_noise: log of its standard deviation [m] where none could be measured.
        """
        return np.float64(np.exp(2.0 * np.nan_to_num(self.pixels[0], nan=log_noise)))


def measure(depth: NDArray[np.float32], reference: Reference, *, with_pixels: bool = True) -> Features:
    """Measure a picture [m] taken by the reference's camera."""
    known = (depth > 0) & (reference.depth > 0)
    difference = np.where(known, depth.astype(np.float64) - reference.depth, 0.0)
    plane = panel_plane(difference, reference.panel & known)
    difference = without_plane(difference, plane)
    inside = known & (reference.cell >= 0)
    cell = reference.cell[inside]
    weight = np.bincount(cell, minlength=reference.count).astype(np.float64)
    total = np.bincount(cell, difference[inside], minlength=reference.count)
    shape = np.where(weight >= reference.least_pixels, total / np.maximum(weight, 1), np.nan)
    pixels = pixel_statistics(depth, reference) if with_pixels else np.full(len(PIXEL_NAMES), np.nan)
    return Features(shape, plane, pixels, weight)
