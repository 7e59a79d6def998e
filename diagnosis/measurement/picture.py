"""Pictures of drapes as a scene's camera sees them, and how far a capture is from one."""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

from diagnosis.measurement.level import levelled
from diagnosis.scene import SimulationScene
from renderer.depth import render_depth
from simcore.drape import Drape

KEPT_PIXELS = 2**24
"""Of the pictures that were asked for last; in single precision 64 MiB a process."""


class _Kept:
    """The pictures that were asked for last: a search looks at the same states again and again."""

    def __init__(self) -> None:
        self._pictures: OrderedDict[tuple[object, ...], NDArray[np.float32]] = OrderedDict()
        self._pixels = 0

    def of(self, drape: Drape, scene: SimulationScene) -> NDArray[np.float32]:
        """Rendered, or as it was."""
        mesh, shape = drape.mesh, hashlib.sha256(drape.vertices.tobytes()).digest()
        key = (shape, mesh, scene.camera, scene.pose, scene.setup.panel)
        if key in self._pictures:
            self._pictures.move_to_end(key)
            return self._pictures[key]
        picture = render_depth(
            drape.vertices, mesh.triangles, scene.camera, scene.camera_from_panel, panel=scene.setup.panel
        )
        picture.flags.writeable = False
        self._pictures[key] = picture
        self._pixels += picture.size
        while self._pixels > KEPT_PIXELS:
            self._pixels -= self._pictures.popitem(last=False)[1].size
        return picture


_kept = _Kept()


def picture_of(drape: Drape, scene: SimulationScene) -> NDArray[np.float32]:
    """The ideal depth picture of a drape in a scene [m]; kept, so not to be written to."""
    return _kept.of(drape, scene)


def depth_rms(depth: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """Root mean square difference where both have data [m]; infinite where they share none."""
    both = (depth > 0) & (other > 0)
    if not both.any():
        return float("inf")
    return float(np.sqrt(np.mean((depth[both].astype(np.float64) - other[both]) ** 2)))


def state_distance(depth: NDArray[np.float32], drape: Drape, scene: SimulationScene) -> float:
    """Root mean square of a capture's levelled difference from a drape's picture [m]; infinite where none is seen."""
    difference = levelled(depth, picture_of(drape, scene), scene)
    seen = np.isfinite(difference)
    return float(np.sqrt(np.mean(difference[seen] ** 2))) if seen.any() else math.inf


def noise_square(scene: SimulationScene) -> float:
    """Variance of the sensor's stated noise [m²] at the panel's distance, with whose square noise grows."""
    farther = (float(scene.camera_from_panel[2, 3]) / scene.sensor.at_m) ** 2
    return (scene.sensor.range_noise_m * farther) ** 2 + scene.sensor.quantisation_m**2 / 12.0
