"""Recording: many frames of a still scene become one depth picture of a capture set."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from capture.capture_set import CAPTURES_FILE, CaptureSet, picture_path, write_captures_json
from capture.documents import FORMAT, CameraDocument, CaptureSetDocument, parse_document
from capture.sources import DepthSource, Frame
from renderer.atomic import write_atomically
from simcore.errors import InputError

_NAME = re.compile(r"\w[\w.\-]{0,99}")

MIN_SHARE_OF_FRAMES = 0.5
"""A pixel counts as seen where at least this share of the frames saw it."""


@dataclass(frozen=True)
class NewCapture:
    """What is said about a capture when it is recorded.

    Attributes:
        fabric: id of the fabric; added to the set if it is new.
        scene: ``hanging`` or ``stretch``.
        density: of the fabric [kg/m²], where known; only used for a new fabric.
        setup: keys of the format's ``setup`` for a set that is new.
        parameters: the fabric's six others, SI, where known, with the relative uncertainty ``parameters_cv``.
    """

    fabric: str
    scene: str
    density: float | None = None
    setup: dict[str, Any] | None = None
    parameters: Mapping[str, float] | None = None
    parameters_cv: float | None = None


def _fabric(new: NewCapture) -> dict[str, Any]:
    """The fabric's entry."""
    entry: dict[str, Any] = {"id": new.fabric, "density": new.density, "parameters": None}
    if new.parameters is not None:
        entry["parameters"] = dict(new.parameters)
        if new.parameters_cv is not None:
            entry["parameters_cv"] = entry["density_cv"] = new.parameters_cv
    return entry


def temporal_median(frames: Iterable[Frame]) -> Frame:
    """Median over time of the pixels with data, uint16 [H, W]; 0 where too few frames have data.

    Raises:
        InputError: ``no_frames``, or frames of different size.
    """
    taken = list(frames)
    if not taken:
        raise InputError("the source gave no depth frame: check that it has a depth stream", code="no_frames")
    if len({frame.shape for frame in taken}) != 1:
        raise InputError("the source's frames differ in size: take them with one camera mode", code="frames_differ")
    stack = np.sort(np.stack(taken), axis=0)  # no data first
    seen = np.count_nonzero(stack, axis=0)
    middle = len(taken) - 1 - seen // 2  # of the last ``seen`` entries the lower median: a value that was measured
    median = np.take_along_axis(stack, np.clip(middle, 0, len(taken) - 1)[None], axis=0)[0]
    return np.where(seen >= max(1.0, MIN_SHARE_OF_FRAMES * len(taken)), median, 0).astype(np.uint16)


def record_capture(source: DepthSource, folder: str | Path, new: NewCapture, *, frames: int = 30) -> str:
    """Add a capture to a set, which is made if it is not there, and return the capture's id.

    The picture is written first and ``captures.json`` last, each whole or not at all: an interrupted recording leaves
    the set as it was.

    Args:
        source: where the frames come from.
        folder: the capture set.
        new: fabric, scene and what else is said.
        frames: how many frames to take the median of, at most.

    Raises:
        InputError: no frames, an empty picture, or a set that cannot take the capture.
    """
    folder = Path(folder)
    if not _NAME.fullmatch(new.fabric):
        raise InputError(
            f"fabric {new.fabric!r} names files: use letters, digits, '-', '_' and '.' only",
            code="fabric_name",
        )
    if frames < 1:
        raise InputError(f"{frames} frames: at least one is needed", code="no_frames")
    document = _document(folder, source, new)
    repeat = sum(1 for c in document["captures"] if c["fabric"] == new.fabric and c["scene"] == new.scene)
    taken = {c["id"] for c in document["captures"]}
    while (name := f"{new.fabric}-{new.scene}-{repeat}") in taken:
        repeat += 1
    entry: dict[str, Any] = {
        "id": name,
        "fabric": new.fabric,
        "scene": new.scene,
        "repeat": repeat,
        "depth": f"{name}.png",
    }
    camera = CameraDocument.from_camera(source.camera).model_dump(mode="json")
    if CameraDocument.model_validate(document["camera"]).as_camera() != source.camera:
        entry["camera"] = camera
    document["captures"].append(entry)
    if all(fabric["id"] != new.fabric for fabric in document["fabrics"]):
        document["fabrics"].append(_fabric(new))
    checked = parse_document(json.dumps(document), str(folder / CAPTURES_FILE))
    path = picture_path(folder, entry["depth"])
    counts = temporal_median(islice(source.frames(), frames))
    if not counts.any():
        raise InputError("every pixel of the frames is without data: take them again", code="depth_empty")
    _write(folder, path, counts, checked)
    return name


def _document(folder: Path, source: DepthSource, new: NewCapture) -> dict[str, Any]:
    """The set's document as plain values, or that of a new set."""
    if (folder / CAPTURES_FILE).exists():
        return CaptureSet.load(folder, read_pictures=False).document.as_json()
    if folder.is_dir() and any(folder.iterdir()):
        raise InputError(
            f"{folder} holds files but no {CAPTURES_FILE}: give a new folder or a capture set", code="folder_in_use"
        )
    return {
        "format": FORMAT,
        "name": folder.name,
        "camera": CameraDocument.from_camera(source.camera).model_dump(mode="json"),
        "setup": new.setup or {},
        "fabrics": [],
        "captures": [],
    }


def _write(folder: Path, path: Path, counts: Frame, document: CaptureSetDocument) -> None:
    from io import BytesIO

    from PIL import Image

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror}", code="cannot_write") from None
    content = BytesIO()
    Image.fromarray(counts).save(content, format="PNG")
    write_atomically(path, content.getvalue())
    write_captures_json(document, folder)
