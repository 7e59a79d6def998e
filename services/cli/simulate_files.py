"""What `drapemeter simulate` writes: the mesh, the depth picture, an entry of a capture set."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture.sources import DepthSource
from diagnosis.scene import SimulationScene
from renderer.camera import Camera
from services.cli.outputs import check_folder
from services.random_streams import SENSOR_STREAM
from simcore.drape import Drape
from simcore.errors import InputError
from simcore.parameters import ESTIMATED_NAMES, FabricParameters

if TYPE_CHECKING:
    from capture.addition import NewCapture

SIMULATED_CV = 0.01
"""Relative uncertainty that a simulated capture set states of its fabrics' parameters: they are known."""


class OnePicture(DepthSource):
    """A depth source of one frame: counts, uint16 [H, W]."""

    def __init__(self, camera: Camera, counts: NDArray[np.uint16]) -> None:
        self._camera, self._counts = camera, counts

    @property
    def camera(self) -> Camera:
        """The camera that took it."""
        return self._camera

    def frames(self) -> Iterator[NDArray[np.uint16]]:
        """The one frame."""
        yield self._counts


def check_outputs(out: Path, depth: Path | None, parameters: Path) -> None:
    """Refuse early what could not be written later, or would take the place of the input.

    Raises:
        InputError: a folder is not there or cannot be written to, a path is a folder, or two are the same file.
    """
    for path in (out,) if depth is None else (out, depth):
        real = Path(os.path.realpath(path))  # where a link leads
        if not real.parent.is_dir():
            raise InputError(f"{path}: its folder does not exist; make it first", code="folder_missing")
        if path.is_dir():
            raise InputError(f"{path} is a folder: name a file", code="output_is_folder")
        if real == Path(os.path.realpath(parameters)):
            raise InputError(f"{path} is the parameters' own file: name another", code="output_is_input")
        if real.exists() and not real.is_file():  # a device, which is written to as it is
            continue
        if not os.access(real.parent, os.W_OK | os.X_OK):
            raise InputError(f"{path}: its folder cannot be written to; name another", code="cannot_write")
    if depth is not None and depth.resolve() == out.resolve():
        raise InputError(f"{out} cannot be both the drape and its depth picture", code="output_twice")


def check_picture(scene: SimulationScene) -> None:
    """Refuse before the drape is simulated what leaves no picture of it: that of the panel alone tells.

    Raises:
        InputError: the camera does not see the panel, or depths do not fit the file's.
    """
    from services.seen_panel import shows_panel

    if not shows_panel(scene, scene.camera.depth_unit_m):
        raise InputError(
            "with these effects of camera and sensor the picture would show nothing at all: give them smaller sizes",
            code="picture_empty",
        )


def take_picture(drape: Drape, scene: SimulationScene, seed: int) -> NDArray[np.float32]:
    """Depth of the drape before its panel as the scene's camera and sensor see it [m], float32 [H, W]."""
    from renderer.depth import render_depth

    ideal = render_depth(
        drape.vertices, drape.mesh.triangles, scene.camera, scene.camera_from_panel, panel=scene.setup.panel
    )
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(SENSOR_STREAM,)))
    return scene.sensor.apply(ideal, rng, camera=scene.camera)


@contextmanager
def files_written(drape: Drape, out: Path, picture: NDArray[np.float32] | None, depth: Path | None) -> Iterator[None]:
    """Write where asked the picture, then the mesh; they appear when the block ends well, each whole or not at all.

    What a disk may refuse is done before the block, so that what happens in it can rely on the files.

    Raises:
        InputError: the picture holds depths that a file cannot hold, or a file cannot be written.
        DrapemeterError: the disk is full.
    """
    from renderer.atomic import prepare
    from renderer.depth_png import depth_png_bytes
    from renderer.ply import ply_bytes

    contents = {} if depth is None or picture is None else {depth: depth_png_bytes(picture)}
    contents[out] = ply_bytes(drape.vertices, drape.mesh.triangles)
    with ExitStack() as stack:
        ready = []
        for path, content in contents.items():
            ready.append(prepare(path, content))
            stack.callback(ready[-1].drop)
        yield
        for file in ready:
            file.put()


@dataclass(frozen=True)
class CapturePlan:
    """The picture's place in a capture set: under the nominal camera, set-up and sensor, whatever effects are on.

    Attributes:
        folder: of the set, made if it is not there.
        fabric: its id in the set.
        cloth: its parameters.
        nominal: the scene without effects.
    """

    folder: Path
    fabric: str
    cloth: FabricParameters
    nominal: SimulationScene

    def check(self) -> None:
        """Find out whether the set can take the picture, before there is one.

        Raises:
            InputError: it cannot.
        """
        from capture.record import check_capture

        check_folder(self.folder, "give --capture-set another folder")
        check_capture(self.folder, self._capture(), self.nominal.camera)

    def add(self, picture: NDArray[np.float32]) -> None:
        """Add the picture.

        Args:
            picture: depth [m], float32 [H, W].

        Raises:
            InputError: the set cannot take it.
        """
        from capture.record import record_capture
        from renderer.depth_png import quantise_depth

        camera = self.nominal.camera
        record_capture(
            OnePicture(camera, quantise_depth(picture, camera.depth_unit_m)), self.folder, self._capture(), frames=1
        )

    def _capture(self) -> NewCapture:
        from capture.addition import NewCapture

        setup, sensor = self.nominal.setup, self.nominal.sensor
        return NewCapture(
            fabric=self.fabric,
            scene=setup.scene.value,
            density=self.cloth.density,
            parameters={name: getattr(self.cloth, name) for name in ESTIMATED_NAMES},
            parameters_cv=SIMULATED_CV,
            setup={
                "sample_size_m": list(setup.sample_size_m),
                "camera_from_panel": self.nominal.camera_from_panel.tolist(),
                "panel": setup.panel,
                "pin_radius_m": setup.pin_radius_m,
                "pins_m": {setup.scene.value: {name: list(place) for name, place in setup.pins_m.items()}},
            },
            sensor={
                "range_noise_m": sensor.range_noise_m,
                "at_m": sensor.at_m,
                "quantisation_m": max(sensor.quantisation_m, self.nominal.camera.depth_unit_m),
            },
        )
