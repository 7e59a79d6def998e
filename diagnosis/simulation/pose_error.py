"""What a pose that was found in the pictures may be wrong by, and what that changes in a picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.measurement.features import measure
from diagnosis.measurement.picture import picture_of
from diagnosis.measurement.reference import Reference
from diagnosis.scene import SimulationScene
from diagnosis.simulation.variations import clean
from renderer.pose import pose_from_rotation
from simcore.drape import Drape

BY_CORNERS_M, BY_OUTLINE_M = 0.003, 0.010
"""Of a camera's place along the panel: where hanging pictures show the pinned corners, and where stretched ones alone
were registered by their outline (``docs/capture.md``)."""
DEPTH_M = 0.003
"""Of its distance; what a panel shows of it is no part of a comparison."""
TURN_RAD = 0.005


def pose_responses(
    drape: Drape, scene: SimulationScene, reference: Reference, along_m: float
) -> NDArray[np.float64] | None:
    """What one standard deviation of such an error changes [m].

    Args:
        drape: the state that is seen.
        scene: how.
        reference: its picture.
        along_m: standard deviation along the panel; 0: the pose is stated.

    Returns:
        float64 [6, cells + ring + 3]: moved along x, y and z of the panel, then turned about them; None where the pose
        is stated.
    """
    if along_m == 0.0:
        return None

    def seen(deviations: NDArray[np.float64]) -> NDArray[np.float64]:
        moved = scene.with_pose(scene.camera_from_panel @ error_pose(deviations, along_m))
        return clean(measure(picture_of(drape, moved), reference, with_pixels=False).vector())

    return np.stack([0.5 * (seen(one) - seen(-one)) for one in np.eye(6)])


def error_pose(deviations: NDArray[np.float64], along_m: float) -> NDArray[np.float64]:
    """The rigid transform in the panel's frame [4, 4] of an error in standard deviations [6], as above."""
    return pose_from_rotation(TURN_RAD * deviations[3:], np.array([along_m, along_m, DEPTH_M]) * deviations[:3])
