"""One more capture for a set: what it may say, and what the set then says."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from capture.capture_set import CAPTURES_FILE, CaptureSet
from capture.documents import (
    FORMAT,
    CameraDocument,
    CaptureSetDocument,
    FabricDocument,
    SensorDocument,
    SetupDocument,
    parse_document,
)
from capture.setup import DEFAULT_SAMPLE_SIZE_M, pin_source, setup_from_document
from renderer.atomic import is_part
from renderer.camera import Camera
from simcore.errors import InputError
from simcore.scenes import Scene, Setup

FOLDER_IN_USE = "folder_in_use"
LOCK_FILE = f".{CAPTURES_FILE}.lock"
"""Whoever adds to a set locks this file, which holds nothing; who reads a set need not."""
LONGEST_NAME = 150
"""Of a fabric's id in a capture's id, which the format limits to 200 characters."""
LONGEST_FILE_NAME = 50
"""Of a name in a file's name: with four bytes a character, 200 of the 255 that file systems take."""
NEW_SETUP: Final[Mapping[str, Any]] = {
    "sample_size_m": list(DEFAULT_SAMPLE_SIZE_M),
    "panel": True,
    "camera_from_panel": None,
}
"""What a new set says of its set-up where nothing else is said."""
SAME = 1e-6
"""Numbers that differ by this share are the same, written with fewer digits."""


@dataclass(frozen=True)
class NewCapture:
    """What is said about a capture when it is recorded.

    A set that is there already says the same of the fabric and of the sensor, or does not take the capture; where it
    says something else of camera and set-up, the capture gets its own.

    Attributes:
        fabric: id of the fabric; added to the set if it is new.
        scene: ``hanging`` or ``stretch``.
        density: of the fabric [kg/m²], where known.
        setup: what is known of the set-up, in the keys of the format's ``setup``.
        parameters: the fabric's six others, SI, where known, with the relative uncertainty ``parameters_cv``, which is
            only used for a new fabric.
        parameters_cv: see there.
        sensor: what is known of the sensor, in the keys of the format's ``sensor``.
    """

    fabric: str
    scene: str
    density: float | None = None
    setup: dict[str, Any] | None = None
    parameters: Mapping[str, float] | None = None
    parameters_cv: float | None = None
    sensor: Mapping[str, float] | None = None


def file_name(name: str) -> str:
    """A name as part of a file's name: letters, digits, ``-``, ``_`` and ``.`` stay."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)[:LONGEST_FILE_NAME]


def with_capture(folder: Path, new: NewCapture, camera: Camera) -> CaptureSetDocument:
    """The set's document, or that of a new set, with the capture as its last; nothing is written.

    Raises:
        InputError: the set cannot be read, says something else of the fabric or the sensor, the folder holds other
            things, or what is said cannot be.
    """
    _check_name(new.fabric)
    there = _read(folder)
    entry = _entry(new, folder, there)
    if there is None:
        base: dict[str, Any] = {
            "format": FORMAT,
            "name": folder.absolute().name,
            "camera": CameraDocument.from_camera(camera).model_dump(mode="json"),
        }
        if new.sensor is not None:
            base["sensor"] = dict(new.sensor)
        base |= {"setup": _new_setup(new), "fabrics": [], "captures": []}
    else:
        base = there.as_json()
        _check_sensor(folder, new, there.sensor, camera)
        setup = there.setup or SetupDocument()
        own = _own_setup(new, setup) | _not_of_this_size(new, setup)
        if there.camera.as_camera() != camera:
            entry["camera"] = CameraDocument.from_camera(camera).model_dump(mode="json")
            if setup.camera_from_panel is not None and "camera_from_panel" not in (new.setup or {}):
                own["camera_from_panel"] = None  # where the set's camera stood says nothing of this one
        if own:
            entry["setup"] = own
    known = {} if there is None else {fabric.id: fabric for fabric in there.fabrics}
    if new.fabric in known:
        _check_fabric(folder, new, known[new.fabric])
    else:
        base["fabrics"].append(_fabric(new))
    base["captures"].append(entry)
    document = parse_document(json.dumps(base), str(folder / CAPTURES_FILE))
    _ = CaptureSet(folder, document).captures  # its set-up can be
    return document


def _check_name(fabric: str) -> None:
    try:
        fabric.encode()
    except UnicodeEncodeError:
        raise InputError(f"fabric {fabric!r} is not text: give another id", code="fabric_name") from None
    if not 1 <= len(fabric) <= 200:
        raise InputError(f"fabric {fabric!r}: give an id of 1 to 200 characters", code="fabric_name")


def _read(folder: Path) -> CaptureSetDocument | None:
    """The document of the set that is there, or None for a new set."""
    if (folder / CAPTURES_FILE).exists():
        return CaptureSet.load(folder, read_pictures=False).document
    if folder.is_dir() and any(path.name != LOCK_FILE and not is_part(path) for path in folder.iterdir()):
        raise InputError(
            f"{folder} holds files but no {CAPTURES_FILE}: give a new folder or a capture set", code=FOLDER_IN_USE
        )
    return None


def _entry(new: NewCapture, folder: Path, there: CaptureSetDocument | None) -> dict[str, Any]:
    """The capture's entry: an id that the set does not have yet, and a picture that its folder does not have."""
    captures = () if there is None else there.captures
    ids = {capture.id for capture in captures}
    pictures = {capture.depth for capture in captures}
    repeat = sum(1 for capture in captures if capture.fabric == new.fabric and capture.scene == new.scene)
    while True:
        capture_id = f"{new.fabric[:LONGEST_NAME]}-{new.scene}-{repeat}"
        depth = f"{file_name(new.fabric)}-{new.scene}-{repeat}.png"
        if capture_id not in ids and depth not in pictures and not (folder / depth).exists():
            return {"id": capture_id, "fabric": new.fabric, "scene": new.scene, "repeat": repeat, "depth": depth}
        repeat += 1


def _fabric(new: NewCapture) -> dict[str, Any]:
    """The fabric's entry."""
    entry: dict[str, Any] = {"id": new.fabric, "density": new.density, "parameters": None}
    if new.parameters is not None:
        entry["parameters"] = dict(new.parameters)
        if new.parameters_cv is not None:
            entry["parameters_cv"] = entry["density_cv"] = new.parameters_cv
    return entry


def _check_fabric(folder: Path, new: NewCapture, there: FabricDocument) -> None:
    """Refuse numbers that the set's fabric of this id does not have: they would be lost."""
    stated = {"density": there.density, **(there.parameters.model_dump() if there.parameters is not None else {})}
    said = {} if new.density is None else {"density": new.density}
    differing = []
    for name, value in {**said, **(new.parameters or {})}.items():
        other = stated.get(name)
        if other is None or not math.isclose(value, other, rel_tol=SAME):
            differing.append(f"{name} is {'not stated' if other is None else f'{other:g}'} there and {value:g} here")
    if differing:
        raise InputError(
            f"{folder} has a fabric {new.fabric!r} with other numbers ({', '.join(differing)}): give the new one "
            "another id (--fabric), or the numbers that the set has",
            code="fabric_differs",
        )


def _check_sensor(folder: Path, new: NewCapture, there: SensorDocument | None, camera: Camera) -> None:
    """Refuse a sensor that the set denies: the format has one for all captures."""
    if there is None or new.sensor is None:
        return
    stated, said = there.model_dump(), dict(new.sensor)
    differing = [
        f"{name} is {stated[name]:g} there and {said[name]:g} here"
        for name in ("range_noise_m", "quantisation_m")
        if stated.get(name) is not None and name in said and not _same_step(stated[name], said[name], camera, name)
    ]
    if differing:
        raise InputError(
            f"{folder} is of another sensor ({', '.join(differing)}), and a set has one sensor: give another set",
            code="sensor_differs",
        )


def _same_step(one: float, other: float, camera: Camera, name: str) -> bool:
    """Steps finer than the pictures' unit are the unit's."""
    least = camera.depth_unit_m if name == "quantisation_m" else 0.0
    return math.isclose(max(one, least), max(other, least), rel_tol=SAME)


def _new_setup(new: NewCapture) -> dict[str, Any]:
    """The set-up of a new set; nominal pins are left to be those of each scene."""
    own = _own_setup(new, SetupDocument())
    return {**NEW_SETUP, **{key: value for key, value in (new.setup or {}).items() if key != "pins_m" or key in own}}


def _own_setup(new: NewCapture, base: SetupDocument) -> dict[str, Any]:
    """What is said of the capture's set-up and the set does not say, or says otherwise."""
    scene = Scene.parse(new.scene)
    there = setup_from_document(scene, base)
    stated: dict[str, Any] = {
        "sample_size_m": there.sample_size_m,
        "panel": there.panel,
        "pin_radius_m": there.pin_radius_m,
        "pins_m": {scene.value: there.pins_m},
        "camera_from_panel": base.camera_from_panel,
    }
    return {key: value for key, value in (new.setup or {}).items() if not _alike(value, stated.get(key))}


def _not_of_this_size(new: NewCapture, base: SetupDocument) -> dict[str, Any]:
    """Nominal pins for a sample of another size than the set's, whose pins are those of that size."""
    said = new.setup or {}
    scene = Scene.parse(new.scene)
    if "sample_size_m" not in said or "pins_m" in said or pin_source(scene, base) == "nominal":
        return {}
    if _alike(said["sample_size_m"], base.sample_size_m or DEFAULT_SAMPLE_SIZE_M):
        return {}
    nominal = Setup.nominal(scene, sample_size_m=tuple(said["sample_size_m"]))
    return {"pins_m": {scene.value: {name: list(place) for name, place in nominal.pins_m.items()}}}


def taken_for_granted(document: CaptureSetDocument, new: NewCapture) -> list[str]:
    """In words, what the last capture of a set does not share with the set although nobody said so, or shares
    although it may be otherwise.

    Args:
        document: as :func:`with_capture` gives it.
        new: what was said of the capture.
    """
    entry, said = document.captures[-1], new.setup or {}
    own = {} if entry.setup is None else entry.setup.model_dump(exclude_unset=True)
    notes = []
    if "camera_from_panel" in own and "camera_from_panel" not in said:
        notes.append("its camera is another one than the set's: where it stood will be found in its picture")
    if entry.camera is not None and document.sensor is not None and new.sensor is None:
        notes.append("its camera is another one than the set's: the set's sensor counts for it, too")
    if "pins_m" in own and "pins_m" not in said:
        notes.append("its sample is of another size than the set's: its pins are the nominal ones of that size")
    return notes


def _alike(value: Any, stated: Any) -> bool:
    """Whether two values of the format, numbers, lists or objects of such, are the same."""
    if isinstance(value, Mapping) and isinstance(stated, Mapping):
        return value.keys() == stated.keys() and all(_alike(value[key], stated[key]) for key in value)
    if isinstance(value, list | tuple) and isinstance(stated, list | tuple):
        return len(value) == len(stated) and all(map(_alike, value, stated))
    if isinstance(value, int | float) and isinstance(stated, int | float):
        return math.isclose(value, stated, rel_tol=SAME, abs_tol=1e-9)
    return bool(value == stated)
