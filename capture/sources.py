"""Where depth frames come from: one small base class, and folders of PNG files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from capture.documents import parse_camera
from renderer.camera import Camera
from renderer.depth_png import read_counts
from simcore.errors import InputError
from simcore.parameters import read_json_object

Frame = NDArray[np.uint16]
"""One depth frame as the sensor gives it: counts of ``camera.depth_unit_m``, uint16 [height, width], 0 = no data."""


class DepthSource(ABC):
    """A stream of depth frames of one camera that does not move; used in a ``with`` block."""

    @property
    @abstractmethod
    def camera(self) -> Camera:
        """Intrinsics and depth unit of the frames."""

    @abstractmethod
    def frames(self) -> Iterator[Frame]:
        """The frames in the order they were taken; a recording ends, a live camera does not."""

    def close(self) -> None:
        """Let go of the device or file."""
        return

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class PngFolderSource(DepthSource):
    """The PNG files of a folder as frames, in the order of their names.

    Args:
        folder: the folder.
        camera: the camera that took them.

    Raises:
        InputError: no such folder, or no PNG in it; while reading, a damaged picture or one of another size.
    """

    def __init__(self, folder: str | Path, camera: Camera) -> None:
        folder = Path(folder)
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder; give a folder of depth PNG files", code="folder_missing")
        self.paths = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".png")
        if not self.paths:
            raise InputError(f"{folder}: holds no PNG file; give a folder of 16-bit depth PNG files", code="no_frames")
        self._camera = camera

    @property
    def camera(self) -> Camera:
        """The camera given."""
        return self._camera

    def frames(self) -> Iterator[Frame]:
        """One frame a file."""
        for path in self.paths:
            counts = read_counts(path)
            if counts.shape != (self._camera.height, self._camera.width):
                raise InputError(
                    f"{path} is {counts.shape[1]} x {counts.shape[0]} pixels, its camera says {self._camera.width} x "
                    f"{self._camera.height}: give the camera of these pictures",
                    code="depth_wrong_size",
                )
            yield counts


def load_camera(path: str | Path) -> Camera:
    """Read a camera from JSON: width, height, fx, fy, cx, cy, depth_unit_m and, if any, distortion (five numbers).

    A file that has these under a key ``camera`` (such as ``captures.json``) will do.

    Raises:
        InputError: no such file, not JSON, or a value is missing or unusable.
    """
    value = read_json_object(path, "camera (width, height, fx, fy, cx, cy, depth_unit_m)")
    return parse_camera(value.get("camera", value), str(path))
