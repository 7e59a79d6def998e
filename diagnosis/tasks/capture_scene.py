"""A capture as the simulator sees it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture.capture_set import Capture
from diagnosis.scene import SimulationScene, pose_rows
from diagnosis.tasks.put_up import as_simulated
from diagnosis.tasks.sensors import sensor_model


def capture_scene(
    capture: Capture, camera_from_panel: NDArray[np.float64], cell_m: float, usual_m: float
) -> SimulationScene:
    """The scene whose simulation should give a capture, without effects.

    Args:
        capture: what its set states of it.
        camera_from_panel: the camera's pose, stated or found, [4, 4].
        cell_m: edge of a mesh cell [m].
        usual_m: distance of the panel in the median of the set's captures [m].

    Raises:
        InputError: a sample or pins that whole cells cannot hold.
    """
    distance_m = float(camera_from_panel[2, 3])
    return SimulationScene(
        as_simulated(capture.id, capture.setup, cell_m),
        camera=capture.camera,
        pose=pose_rows(camera_from_panel),
        sensor=sensor_model(capture.sensor, capture.camera.depth_unit_m, distance_m, usual_m),
    )
