"""The sensor as a set states it, and what it states of sensors that no simulation takes up."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from capture.capture_set import CaptureSet
from capture.documents import SensorDocument
from renderer.sensor import SensorModel

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


def usual_distance(poses: Iterable[NDArray[np.float64]]) -> float:
    """The median distance of the panel along the camera's axis [m], of poses [4, 4] of the panel before the camera."""
    return float(np.median([pose[2, 3] for pose in poses]))


def sensor_model(document: SensorDocument | None, depth_unit_m: float, panel_m: float, usual_m: float) -> SensorModel:
    """The sensor as stated, its steps no finer than those in which pictures are kept; ideal where nothing is stated.

    Its noise is restated for one distance of the whole set: so much noise more or less is as probable, and as large,
    whatever distance a data sheet goes by.

    Args:
        document: what is stated.
        depth_unit_m: step in which pictures are kept [m].
        panel_m: distance of the panel along the camera's axis [m], where it is not said at which one noise is stated.
        usual_m: the same in the median of the set's captures.
    """
    if document is None:
        return SensorModel()
    return SensorModel(
        range_noise_m=(document.range_noise_m or 0.0) * (usual_m / (document.at_m or panel_m)) ** 2,
        at_m=usual_m,
        quantisation_m=max(document.quantisation_m or 0.0, depth_unit_m),
    )
