"""Whether a camera and its sensor leave anything of a picture: that of the panel alone tells, before any simulation."""

from __future__ import annotations

import numpy as np

from diagnosis.scene import SimulationScene
from renderer.depth import panel_depth
from renderer.depth_png import quantise_depth


def shows_panel(scene: SimulationScene, depth_unit_m: float) -> bool:
    """Whether a picture of the panel alone holds any reading.

    Args:
        scene: camera, pose and sensor.
        depth_unit_m: of the file or store [m].

    Raises:
        InputError: the camera stands behind the panel, or 16 bits of this unit do not hold its depths.
    """
    depth = panel_depth(scene.camera, scene.camera_from_panel)
    seen = np.where(np.isinf(depth), np.float32(0.0), depth)  # rays that miss it show nothing
    read = scene.sensor.apply(seen, np.random.default_rng(0), camera=scene.camera)
    return bool(quantise_depth(read, depth_unit_m).any())
