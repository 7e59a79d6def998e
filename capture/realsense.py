"""RealSense depth cameras and their recordings (``.bag``, ``.db3``) through ``pyrealsense2``, where it is installed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.sources import DepthSource, Frame
from renderer.camera import Camera
from simcore.errors import InputError, MissingResourceError

RECORDING_SUFFIXES = (".bag", ".db3")

_FRAME_TIMEOUT_MS = 5000
_END_TIMEOUT_MS = 1000
_MAX_REFIT_PX = 0.3
"""Root mean square over the picture; an SR300's lens is met to 0.2, its outermost corners to about 1 [pixel]."""


@dataclass(frozen=True)
class StreamMode:
    """What to ask a live camera for; None leaves it to the camera."""

    width: int | None = None
    height: int | None = None
    frames_per_second: int | None = None


class RealSenseSource(DepthSource):
    """Depth frames of a live camera or of a recording.

    A recording is played once and not in real time, so that no frame is dropped however slow the reader is.

    Args:
        recording: a ``.bag`` or ``.db3`` file; None opens a camera.
        serial: of the camera to open, where several are connected.
        mode: picture size and rate of a live camera.

    Raises:
        MissingResourceError: ``pyrealsense2`` is not installed, or no camera answers.
        InputError: no such recording, one without a depth stream, or lens distortion of a kind that cannot be used.
    """

    def __init__(
        self, recording: str | Path | None = None, *, serial: str | None = None, mode: StreamMode = StreamMode()
    ) -> None:
        path = None if recording is None else _recording_path(recording)
        self._rs = import_realsense()
        self._recorded = path is not None
        config = self._rs.config()
        if path is not None:
            self._name = str(path)
            config.enable_device_from_file(self._name, repeat_playback=False)
        else:
            self._name = f"camera {serial}" if serial else "camera"
            if serial:
                config.enable_device(serial)
            config.enable_stream(
                self._rs.stream.depth,
                mode.width or 0,
                mode.height or 0,
                self._rs.format.z16,
                mode.frames_per_second or 0,
            )
        self._pipeline = self._rs.pipeline()
        try:
            if recording is not None:  # before the start, or the first frames are played in real time and dropped
                resolved = config.resolve(self._rs.pipeline_wrapper(self._pipeline))
                resolved.get_device().as_playback().set_real_time(False)
            profile = self._pipeline.start(config)
            try:
                self._camera = self._read_camera(profile)
            except BaseException:
                self._pipeline.stop()
                raise
        except RuntimeError as error:
            raise self._cannot_open(error) from None

    @property
    def camera(self) -> Camera:
        """Intrinsics of the depth stream and the sensor's depth unit."""
        return self._camera

    def frames(self) -> Iterator[Frame]:
        """Depth frames; ends with the recording.

        Raises:
            MissingResourceError: a live camera stops sending.
        """
        while True:
            got, frames = self._pipeline.try_wait_for_frames(_END_TIMEOUT_MS if self._recorded else _FRAME_TIMEOUT_MS)
            if not got:
                if self._recorded:
                    return
                raise MissingResourceError(
                    f"{self._name} sends no frames: check its USB 3 cable and that no other program uses it",
                    code="camera_silent",
                )
            depth = frames.get_depth_frame()
            if depth:
                yield np.array(depth.get_data(), dtype=np.uint16)

    def close(self) -> None:
        """Stop the stream."""
        self._pipeline.stop()

    def _read_camera(self, profile: Any) -> Camera:
        stream = profile.get_stream(self._rs.stream.depth).as_video_stream_profile()
        unit = float(f"{profile.get_device().first_depth_sensor().get_depth_scale():.6g}")  # a float32 in the driver
        return camera_from_intrinsics(stream.get_intrinsics(), unit)

    def _cannot_open(self, error: RuntimeError) -> InputError | MissingResourceError:
        if self._recorded:
            return InputError(f"{self._name}: not a recording with a depth stream ({error})", code="recording_unusable")
        return MissingResourceError(
            f"no RealSense {self._name} answers ({error}): connect one to a USB 3 port, or import a recording",
            code="camera_missing",
        )


def import_realsense() -> Any:
    """The ``pyrealsense2`` module.

    Raises:
        MissingResourceError: it is not installed.
    """
    try:
        import pyrealsense2
    except ImportError as error:
        raise MissingResourceError(
            f"pyrealsense2 cannot be imported ({error}): .venv/bin/pip install -e '.[realsense]' in the project's "
            "folder, or export the depth frames as 16-bit PNG files and import their folder",
            code="realsense_missing",
        ) from None
    return pyrealsense2


def camera_from_intrinsics(intrinsics: Any, depth_unit_m: float) -> Camera:
    """The camera of ``rs.intrinsics``; its distortion is turned into the OpenCV model where it is another.

    Raises:
        InputError: a fisheye model, or one that the OpenCV model does not meet within 0.3 pixel rms.
    """
    model = str(intrinsics.model).rsplit(".", 1)[-1].lower().replace(" ", "_")
    coefficients = tuple(float(c) for c in intrinsics.coeffs)
    k1, k2, p1, p2, k3 = coefficients
    if model == "inverse_brown_conrady":
        k1, k2, p1, p2, k3 = _forward_distortion(intrinsics, coefficients)
    elif model not in ("none", "brown_conrady") and any(coefficients):
        raise InputError(
            f"the depth stream has lens distortion of model {model!r}, which cannot be used: record rectified depth",
            code="distortion",
        )
    return Camera(
        width=int(intrinsics.width),
        height=int(intrinsics.height),
        fx=float(intrinsics.fx),
        fy=float(intrinsics.fy),
        cx=float(intrinsics.ppx),
        cy=float(intrinsics.ppy),
        distortion=(k1, k2, p1, p2, k3),
        depth_unit_m=depth_unit_m,
    )


def _forward_distortion(intrinsics: Any, inverse: tuple[float, ...]) -> tuple[float, ...]:
    """OpenCV coefficients of a lens whose model undoes the distortion (older RealSense cameras).

    The inverse model gives the undistorted place of any pixel; the forward model is linear in its five coefficients, so
    that a least-squares fit over the picture finds them.
    """
    column, row = np.meshgrid(np.linspace(0, intrinsics.width - 1, 41), np.linspace(0, intrinsics.height - 1, 31))
    seen = np.stack([(column.ravel() - intrinsics.ppx) / intrinsics.fx, (row.ravel() - intrinsics.ppy) / intrinsics.fy])
    terms = _distortion_terms(seen)
    true = seen + terms @ np.asarray(inverse)
    design = _distortion_terms(true)
    wanted = seen - true
    solution = np.linalg.lstsq(design.reshape(-1, 5), wanted.ravel(), rcond=None)[0]
    residual = np.linalg.norm(design @ solution - wanted, axis=0)
    error = float(np.sqrt(np.mean(residual**2))) * max(intrinsics.fx, intrinsics.fy)
    if error > _MAX_REFIT_PX:
        raise InputError(
            f"the lens distortion of the depth stream cannot be expressed in the OpenCV model (off by {error:.2f} "
            "pixel): record rectified depth",
            code="distortion",
        )
    return tuple(float(c) for c in solution)


def _distortion_terms(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """What each of k1, k2, p1, p2, k3 adds to normalised coordinates, shape [2, N] -> [2, N, 5]."""
    x, y = xy
    r2 = x * x + y * y
    return np.stack(
        [
            np.stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3], axis=-1),
            np.stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3], axis=-1),
        ]
    )


def _recording_path(recording: str | Path) -> Path:
    path = Path(recording)
    if not path.is_file():
        raise InputError(f"{path}: no such recording", code="recording_missing")
    if path.suffix.lower() not in RECORDING_SUFFIXES:
        raise InputError(
            f"{path}: a RealSense recording ends in {' or '.join(RECORDING_SUFFIXES)}", code="recording_unusable"
        )
    return path
