"""A capture of nothing in particular, for tests of what is written around the picture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.addition import NewCapture
from capture.record import record_capture
from capture.sources import DepthSource, Frame
from renderer.camera import CANONICAL_CAMERA, Camera


class Flat(DepthSource):
    """A picture with the same count everywhere."""

    def __init__(self, count: int = 9000, camera: Camera = CANONICAL_CAMERA) -> None:
        self._counts: NDArray[np.uint16] = np.full((camera.height, camera.width), count, np.uint16)
        self._camera = camera

    @property
    def camera(self) -> Camera:
        return self._camera

    def frames(self) -> Iterator[Frame]:
        yield self._counts


def add(folder: Path, fabric: str = "f1", scene: str = "hanging", **said: Any) -> str:
    """Add a flat picture to a set."""
    return record_capture(Flat(), folder, NewCapture(fabric, scene, **said), frames=1)
