"""What the simulation of one capture needs, in one frozen value that effects change."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.camera import CANONICAL_CAMERA, Camera, frontal_pose
from renderer.pose import check_pose
from renderer.sensor import IDEAL_SENSOR, SensorModel
from simcore.mechanics import Mechanics
from simcore.scenes import Setup

PUT_UP_AGAIN_M = 0.002
"""Magnets that are stated to sit so near to where they sat make a repeat: a person puts them back no better."""

Pose = tuple[tuple[float, float, float, float], ...]


def pose_rows(matrix: NDArray[np.float64]) -> Pose:
    """A rigid transform [4, 4] as nested tuples, so that scenes can be compared.

    Raises:
        InputError: not a rigid transform.
    """
    rows = check_pose(matrix).tolist()
    return tuple((row[0], row[1], row[2], row[3]) for row in rows)


def put_up_alike(one: Setup, other: Setup) -> bool:
    """Whether captures of two set-ups repeat each other: what effects do in one they do in the other."""
    if replace(one, pins_m=other.pins_m) != other:
        return False
    return all(np.linalg.norm(np.subtract(one.pins_m[n], other.pins_m[n])) <= PUT_UP_AGAIN_M for n in one.pins_m)


@dataclass(frozen=True)
class SimulationScene:
    """One capture as the simulator sees it.

    Attributes:
        setup: scene, pins and panel (panel frame, [m]).
        mechanics: physics beyond the baseline.
        camera: intrinsics of the camera that takes the picture.
        pose: ``camera_from_panel``, rows of a [4, 4] rigid transform.
        sensor: what the depth sensor does to the ideal picture.
    """

    setup: Setup
    mechanics: Mechanics = Mechanics()
    camera: Camera = CANONICAL_CAMERA
    pose: Pose = pose_rows(frontal_pose())
    sensor: SensorModel = IDEAL_SENSOR

    @property
    def camera_from_panel(self) -> NDArray[np.float64]:
        """The camera's pose, float64 [4, 4]."""
        return np.asarray(self.pose, dtype=np.float64)

    def with_mechanics(self, **changes: Any) -> SimulationScene:
        """The same with some of the mechanics changed."""
        return replace(self, mechanics=replace(self.mechanics, **changes))

    def with_sensor(self, **changes: Any) -> SimulationScene:
        """The same with some of the sensor's mechanisms changed."""
        return replace(self, sensor=replace(self.sensor, **changes))

    def with_setup(self, setup: Setup) -> SimulationScene:
        """The same put up otherwise."""
        return replace(self, setup=setup)

    def with_pose(self, camera_from_panel: NDArray[np.float64]) -> SimulationScene:
        """The same seen from elsewhere; [4, 4]."""
        return replace(self, pose=pose_rows(camera_from_panel))
