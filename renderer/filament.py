"""Open3D's offscreen renderer (Filament on Vulkan), kept in a child process because of its faults.

* Every picture leaks (measured: 3.3 MB at 512 x 512 under software Vulkan), and after 131,042 pictures a process draws
  blank ones without an error (Open3D issue 6912): the child is replaced when it has grown or drawn too much.
* Without a Vulkan device Filament aborts its process: only the child dies, and that is an error with its reason.
* It works on its creating thread only: the child has one, callers take turns.
* It prints to standard output: the child's goes elsewhere.
"""

from __future__ import annotations

import atexit
import os
import pickle
import select
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from dataclasses import dataclass
from typing import IO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.camera import Camera
from renderer.light import Light
from renderer.surface import check_surface
from simcore.errors import DrapemeterError, InputError, MissingResourceError

MAX_RENDERS = 100_000
MAX_GROWTH_MB = 500.0
_PATIENCE_S = 120.0


@dataclass(frozen=True)
class DrawRequest:
    """One picture to draw: mesh [m] in the panel frame, camera, pose [4, 4], unit vector to the light, camera frame."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    uv: NDArray[np.float64]
    camera: Camera
    camera_from_panel: NDArray[np.float64]
    towards_light: NDArray[np.float64]


@dataclass(frozen=True)
class DrawReply:
    """Share of the direct light, float32 [H, W], NaN where there is no cloth; None = ready. The child's memory [MB]."""

    facing: NDArray[np.float32] | None
    resident_mb: float


class FilamentProcess:
    """The child that draws; callers from any thread take turns. Restarted when it has grown too large."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._errors: IO[bytes] | None = None
        self._size = (0, 0)
        self._renders = 0
        self._first_mb = 0.0

    @property
    def pid(self) -> int | None:
        """Process number of the child, if there is one."""
        return None if self._child is None else self._child.pid

    def start(self, width: int, height: int) -> None:
        """See to it that a child stands ready for pictures of this size; it draws one size only.

        Raises:
            MissingResourceError: it cannot draw on this machine.
        """
        with self._lock:
            self._ensure((width, height))

    def draw(self, request: DrawRequest) -> NDArray[np.float32]:
        """Share of the direct light that each pixel's cloth sends back, float32 [H, W]; NaN where there is none.

        Raises:
            MissingResourceError: as :meth:`start`.
            DrapemeterError: ``renderer_died``: the child ended or hung while it drew.
        """
        with self._lock:
            child = self._ensure((request.camera.width, request.camera.height))
            assert child.stdin is not None
            try:
                pickle.dump(request, child.stdin)
                child.stdin.flush()
                reply = self._reply(child)
            except (EOFError, BrokenPipeError, TimeoutError, pickle.UnpicklingError) as error:
                reason = self._end()
                raise DrapemeterError(
                    f"the offscreen renderer stopped while drawing ({reason or error}): try again, "
                    "or choose engine 'raycast'",
                    code="renderer_died",
                ) from error
            self._renders += 1
            if self._renders >= MAX_RENDERS or reply.resident_mb - self._first_mb > MAX_GROWTH_MB:
                self._end()
            assert reply.facing is not None
            return reply.facing

    def close(self) -> None:
        """End the child; the next picture starts another."""
        with self._lock:
            self._end()

    def _ensure(self, size: tuple[int, int]) -> subprocess.Popen[bytes]:
        if self._child is not None and self._child.poll() is None and self._size == size:
            return self._child
        self._end()
        self._size = size
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the child, closed with it
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        self._child = subprocess.Popen(
            [sys.executable, "-P", "-m", "renderer.filament_worker", *map(str, size)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=environment,
        )
        try:
            self._first_mb, self._renders = self._reply(self._child).resident_mb, 0
        except (EOFError, TimeoutError, pickle.UnpicklingError) as error:
            reason = self._end()
            raise MissingResourceError(
                f"Open3D's offscreen renderer does not run here ({reason or error}): install libvulkan1 and "
                "mesa-vulkan-drivers, or choose engine 'raycast'",
                code="vulkan_missing",
            ) from error
        return self._child

    def _reply(self, child: subprocess.Popen[bytes]) -> DrawReply:
        assert child.stdout is not None
        if not select.select([child.stdout], [], [], _PATIENCE_S)[0]:
            raise TimeoutError(f"no picture within {_PATIENCE_S:g} s")
        reply: DrawReply = pickle.load(child.stdout)
        return reply

    def _end(self) -> str:
        """End the child and give the last line it wrote to standard error."""
        child, errors, self._child, self._errors = self._child, self._errors, None, None
        if child is not None:
            child.kill()
            child.wait()
            for pipe in (child.stdin, child.stdout):
                if pipe is not None:
                    with suppress(BrokenPipeError):  # of what was still to be sent to a dead child
                        pipe.close()
        if errors is None:
            return ""
        with errors:
            errors.seek(0)
            lines = errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1].strip() if lines else ""


_process = FilamentProcess()
atexit.register(_process.close)


def filament_process() -> FilamentProcess:
    """The one child of this process."""
    return _process


def check_filament_camera(camera: Camera) -> None:
    """Refuse a camera that Filament cannot imitate.

    Raises:
        InputError: the camera has lens distortion.
    """
    if camera.distorted:
        raise InputError(
            "the filament engine draws no lens distortion: choose engine 'raycast' for this camera", code="distortion"
        )


def filament_radiance(
    vertices: ArrayLike,
    triangles: ArrayLike,
    uv: ArrayLike | None,
    camera: Camera,
    camera_from_panel: NDArray[np.float64],
    light: Light,
) -> NDArray[np.float64]:
    """Linear radiance of the cloth, float64 [H, W]; 0 where there is none.

    Raises:
        InputError: the mesh cannot be rendered.
        MissingResourceError, DrapemeterError: see :class:`FilamentProcess`.
    """
    v, t = check_surface(vertices, triangles)
    coordinates = np.zeros((len(v), 2)) if uv is None else np.asarray(uv, dtype=np.float64)
    if coordinates.shape != (len(v), 2):
        raise InputError(f"uv must have shape [{len(v)}, 2], got {coordinates.shape}", code="mesh_shape")
    facing = _process.draw(DrawRequest(v, t, coordinates, camera, camera_from_panel, light.towards))
    radiance = light.albedo * (light.ambient + light.direct * facing.astype(np.float64))
    return np.nan_to_num(radiance, nan=0.0)
