"""What a set states of sensors that no simulation takes up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from capture.capture_set import CaptureSet

NAMED = 3
"""So many are named in a line."""


def sensors_passed_over(captures: CaptureSet) -> Iterator[str]:
    """In words, what is stated of sensors and not used, and captures of a camera whose sensor is not the one stated."""
    document = captures.document
    said = [(f"sensor.{key}", value) for key, value in _further(document.sensor).items()]
    said.append(("camera.sensor", _further(document.camera).get("sensor")))
    for entry in document.captures:
        said.append((f"sensor of capture {entry.id}", _further(entry).get("sensor")))
        said.append((f"camera.sensor of capture {entry.id}", _further(entry.camera).get("sensor")))
    unused = [name for name, value in said if value is not None]
    if unused:
        yield (
            f"stated, but not used: {_named(unused)}; of sensors the set's range_noise_m, at_m and quantisation_m "
            "count, for all captures"
        )
    camera = document.camera.as_camera()
    other = [c.id for c in captures.captures if c.camera != camera]
    if other and document.sensor is not None:
        yield f"capture {_named(other)}: the camera is another one than the set's: the set's sensor counts for it, too"


def _further(model: BaseModel | None) -> Mapping[str, Any]:
    """Keys that the format does not name."""
    return {} if model is None else model.model_extra or {}


def _named(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
