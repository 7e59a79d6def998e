"""The simulated fold state that is nearest to a capture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.scene import SimulationScene
from diagnosis.simulator import KeyedDrape, Simulator
from renderer.depth import render_depth
from simcore.drape import Drape
from simcore.parameters import FabricParameters

VISIBLE_M = 0.01


def picture_of(drape: Drape, scene: SimulationScene) -> NDArray[np.float32]:
    """The ideal depth picture of a drape in a scene [m]."""
    return render_depth(
        drape.vertices, drape.mesh.triangles, scene.camera, scene.camera_from_panel, panel=scene.setup.panel
    )


def depth_rms(depth: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """Root mean square difference where both have data [m]; infinite where they share none."""
    both = (depth > 0) & (other > 0)
    if not both.any():
        return float("inf")
    return float(np.sqrt(np.mean((depth[both].astype(np.float64) - other[both]) ** 2)))


def warp_to_picture(drape: Drape, scene: SimulationScene, depth: NDArray[np.float32]) -> NDArray[np.float64]:
    """Vertices moved along their rays to the capture's (lightly smoothed) depth, [vertex_count, 3], panel frame.

    Hidden vertices stay. The result is no equilibrium: the solver is started from it and falls into the fold state
    that the capture shows, where the simulated cloth has one.
    """
    from scipy import ndimage

    pose = scene.camera_from_panel
    own = picture_of(drape, scene)
    known = (depth > 0) & (own > 0)
    blurred = ndimage.gaussian_filter(np.where(known, depth - own, 0.0), 2.0)
    weight = ndimage.gaussian_filter(known.astype(np.float64), 2.0)
    residual = blurred / np.maximum(weight, 1e-6)
    points = drape.vertices @ pose[:3, :3].T + pose[:3, 3]
    pixels = scene.camera.project(points)
    where = np.nan_to_num([pixels[:, 1], pixels[:, 0]])
    move = ndimage.map_coordinates(residual, where, order=1, mode="nearest")
    surface = ndimage.map_coordinates(own, where, order=1, mode="nearest")
    visible = np.abs(surface - points[:, 2]) < VISIBLE_M
    moved = points * (1 + np.where(visible, move, 0.0) / points[:, 2])[:, None]
    vertices = (moved - pose[:3, 3]) @ pose[:3, :3]
    if scene.setup.panel:
        vertices[:, 2] = np.maximum(vertices[:, 2], 2e-4)
    return np.asarray(vertices)


def nearest_state(
    simulator: Simulator,
    fabric: FabricParameters,
    scene: SimulationScene,
    depth: NDArray[np.float32],
    candidates: list[KeyedDrape],
) -> tuple[KeyedDrape, float]:
    """The nearest of some drapes, of that one's mirror image and of what the solver finds from the capture's shape.

    Returns:
        The drape and its root mean square difference from the capture [m].
    """
    scored = [(depth_rms(depth, picture_of(c.drape, scene)), n, c) for n, c in enumerate(candidates)]
    _, _, best = min(scored)
    guided = simulator.proceed(
        simulator.shaped(best.drape.mesh, warp_to_picture(best.drape, scene, depth)), fabric, scene
    )
    scored.append((depth_rms(depth, picture_of(guided.drape, scene)), len(scored), guided))
    usable = [entry for entry in scored if entry[2].drape.ok] or scored
    rms, _, best = min(usable)
    return best, rms
