"""A capture set: a folder with ``captures.json`` and one depth picture a capture."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.documents import (
    FORMAT,
    CameraDocument,
    CaptureDocument,
    CaptureSetDocument,
    FabricDocument,
    SensorDocument,
    SetupDocument,
    check_references,
    parse_document,
)
from capture.picture import Depth, read_depth
from capture.setup import pin_source, setup_from_document
from renderer.atomic import write_atomically
from renderer.camera import Camera
from renderer.pose import nearest_pose
from simcore.errors import InputError
from simcore.scenes import Scene, Setup

CAPTURES_FILE = "captures.json"


@dataclass(frozen=True)
class Capture:
    """One depth picture with everything the set says about it; its own ``camera`` and ``setup`` already applied.

    Attributes:
        id: unique in the set.
        fabric: the fabric it shows.
        scene: how the sample is held.
        repeat: number of the repeat, from 0.
        depth_path: the 16-bit PNG.
        camera: intrinsics.
        setup: pins, sample size, pin radius, panel; nominal where the set is silent.
        pins_from: ``given``, ``pin_distance`` or ``nominal``: where the set-up's pins come from.
        camera_from_panel: pose of the camera, float64 [4, 4], or None when it has to be estimated.
        sensor: what is known of the sensor, or None.
        document: the capture's entry as read.
    """

    id: str
    fabric: FabricDocument
    scene: Scene
    repeat: int
    depth_path: Path
    camera: Camera
    setup: Setup
    pins_from: str
    camera_from_panel: NDArray[np.float64] | None
    sensor: SensorDocument | None
    document: CaptureDocument

    def read_depth(self) -> Depth:
        """The picture in metres, float32, shape [height, width], 0 = no data.

        Raises:
            InputError: missing, damaged, not 16-bit, of another size than the camera, or empty.
        """
        return read_depth(self.depth_path, self.camera)


@dataclass(frozen=True)
class CaptureSet:
    """A folder of captures, checked.

    Attributes:
        folder: where it lies.
        document: ``captures.json`` as read, extra keys included.
    """

    folder: Path
    document: CaptureSetDocument

    @classmethod
    def load(cls, folder: str | Path, *, read_pictures: bool = True) -> CaptureSet:
        """Read and check a capture set, nothing being written.

        Args:
            folder: the folder that holds ``captures.json``.
            read_pictures: decode every picture (some milliseconds each), so that damage is found now and not in the
                middle of the work; otherwise :meth:`Capture.read_depth` finds it.

        Raises:
            InputError: see ``docs/capture.md`` for the codes.
        """
        folder = Path(folder)
        path = folder / CAPTURES_FILE
        if not folder.is_dir():
            raise InputError(
                f"{folder}: no such folder; give a capture set, a folder with {CAPTURES_FILE}",
                code="capture_set_missing",
            )
        try:
            text = path.read_text(encoding="utf-8-sig")
        except FileNotFoundError:
            raise InputError(
                f"{folder}: not a capture set, it has no {CAPTURES_FILE}; "
                "`drapemeter capture import` makes one from depth pictures",
                code="captures_json_missing",
            ) from None
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: cannot be read as text ({error})", code="file_unreadable") from None
        capture_set = cls(folder, parse_document(text, str(path)))
        for capture in capture_set.captures:
            if read_pictures:
                capture.read_depth()
        return capture_set

    @cached_property
    def fabrics(self) -> dict[str, FabricDocument]:
        """Fabrics by id, in the set's order."""
        return {fabric.id: fabric for fabric in self.document.fabrics}

    @cached_property
    def captures(self) -> tuple[Capture, ...]:
        """All captures, in the set's order.

        Raises:
            InputError: ``path_outside_set``, ``camera``, ``pose``, or a set-up that cannot be.
        """
        return tuple(self._resolve(entry) for entry in self.document.captures)

    def of_fabric(self, fabric_id: str) -> tuple[Capture, ...]:
        """Captures of one fabric, in the set's order."""
        return tuple(c for c in self.captures if c.fabric.id == fabric_id)

    def save(self, folder: str | Path | None = None) -> Path:
        """Write ``captures.json`` (checked again, whole or not at all) and return its path; pictures are not copied.

        Raises:
            InputError: the document is not consistent, or the folder cannot be written.
        """
        target = Path(folder) if folder is not None else self.folder
        write_captures_json(self.document, target)
        return target / CAPTURES_FILE

    def stated_setup(self, entry: CaptureDocument) -> SetupDocument:
        """What the set and this capture state of its set-up; the capture's own word counts."""
        return (self.document.setup or SetupDocument()).overridden_by(entry.setup)

    def _resolve(self, entry: CaptureDocument) -> Capture:
        setup = self.stated_setup(entry)
        scene = Scene(entry.scene)
        where = f"{self.folder / CAPTURES_FILE}: capture {entry.id!r}"
        pose = setup.camera_from_panel
        try:
            camera_from_panel = None if pose is None else nearest_pose(pose)
            return Capture(
                id=entry.id,
                fabric=self.fabrics[entry.fabric],
                scene=scene,
                repeat=entry.repeat or 0,
                depth_path=picture_path(self.folder, entry.depth),
                camera=(entry.camera or self.document.camera).as_camera(),
                setup=setup_from_document(scene, setup),
                pins_from=pin_source(scene, setup),
                camera_from_panel=camera_from_panel,
                sensor=self.document.sensor,
                document=entry,
            )
        except InputError as error:
            raise InputError(f"{where}: {error}", code=error.code) from None


def picture_path(folder: Path, name: str, *, writing: bool = False) -> Path:
    """Path of a picture named in a set.

    Args:
        folder: the set's.
        name: as the set says it: relative to the folder, inside it.
        writing: the picture is to be written, so that links must stay inside, too; one that is read may be a link.

    Raises:
        InputError: ``path_outside_set``: absolute, with ``..`` that leads out, or a link that leads to itself or, where
            it is written, out.
    """
    path = folder / name
    try:
        inside = "\0" not in name and not Path(name).is_absolute()
        inside = inside and Path(os.path.normpath(path.absolute())).is_relative_to(os.path.normpath(folder.absolute()))
        inside = inside and (path.resolve().is_relative_to(folder.resolve()) or not writing)
    except (RuntimeError, OSError) as error:  # a link that leads to itself: RuntimeError until Python 3.12
        raise InputError(
            f"depth {name!r} cannot be followed ({error}): put the picture itself into the folder",
            code="path_outside_set",
        ) from None
    if not inside:
        raise InputError(
            f"depth {name!r} leads outside the capture set: give a path relative to the folder, inside it",
            code="path_outside_set",
        )
    return path


def write_captures_json(document: CaptureSetDocument, folder: Path) -> None:
    """Check a document and write it as ``captures.json``; the file appears whole or not at all.

    Raises:
        InputError: the document is not consistent, or the folder cannot be written.
    """
    check_references(document, CAPTURES_FILE)
    text = json.dumps(document.as_json(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    parse_document(text, CAPTURES_FILE)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror}", code="cannot_write") from None
    write_atomically(folder / CAPTURES_FILE, text.encode())


def new_document(
    *,
    name: str,
    camera: Camera,
    fabrics: Iterable[dict[str, Any]],
    captures: Iterable[dict[str, Any]],
    setup: dict[str, Any] | None = None,
    sensor: dict[str, Any] | None = None,
) -> CaptureSetDocument:
    """Put a document together from plain values in the format's own keys, for programs that write sets.

    Raises:
        InputError: a value is missing or unusable.
    """
    value: dict[str, Any] = {
        "format": FORMAT,
        "name": name,
        "camera": CameraDocument.from_camera(camera).model_dump(mode="json"),
    }
    if sensor is not None:
        value["sensor"] = sensor
    if setup is not None:
        value["setup"] = setup
    value |= {"fabrics": list(fabrics), "captures": list(captures)}
    return parse_document(json.dumps(value), CAPTURES_FILE)
