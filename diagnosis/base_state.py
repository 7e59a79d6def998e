"""The simulated fold state that is nearest to a capture."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from diagnosis.level import levelled
from diagnosis.scene import SimulationScene
from diagnosis.simulator import KeyedDrape, Simulator
from diagnosis.state_library import SAME_STATE_M, StateLibrary, vertex_rms
from renderer.depth import render_depth
from simcore.drape import Drape
from simcore.parameters import FabricParameters

VISIBLE_M = 0.01
ROUNDS = 1
STARTS = {"hanging": 1, "stretch": 3}
"""Of so many of the nearest states, one after the other, the capture's heights lead on: each may end in other folds."""
GOOD_ENOUGH_M = {"hanging": 0.003, "stretch": 0.0008}
"""A state whose difference from the capture is noise but for this needs no further search."""


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


def state_distance(depth: NDArray[np.float32], drape: Drape, scene: SimulationScene) -> float:
    """Root mean square of a capture's levelled difference from a drape's picture [m]; infinite where none is seen."""
    difference = levelled(depth, picture_of(drape, scene), scene)
    seen = np.isfinite(difference)
    return float(np.sqrt(np.mean(difference[seen] ** 2))) if seen.any() else math.inf


def warp_to_picture(
    drape: Drape, scene: SimulationScene, depth: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Vertices moved along their rays to the capture's levelled, lightly smoothed depth, and which of them are seen.

    Hidden vertices stay. Returns positions [vertices, 3] in the panel frame and bool [vertices].
    """
    from scipy import ndimage

    pose = scene.camera_from_panel
    own = picture_of(drape, scene)
    difference = levelled(depth, own, scene)
    known = np.isfinite(difference)
    blurred = ndimage.gaussian_filter(np.where(known, difference, 0.0), 1.5)
    weight = ndimage.gaussian_filter(known.astype(np.float64), 1.5)
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
    return np.asarray(vertices), visible


def nearest_state(
    simulator: Simulator,
    fabric: FabricParameters,
    scene: SimulationScene,
    depth: NDArray[np.float32],
    candidates: list[KeyedDrape],
    enough: Mapping[str, float] | None = None,
) -> tuple[KeyedDrape, float]:
    """The nearest of some fold states and of the equilibrium that the solver finds when led by the capture's heights.

    Args:
        simulator, fabric, scene: what is simulated.
        depth: of the capture [m].
        candidates: states put up without the capture; at least one.
        enough: by key of a state, the distance [m] within which no nearer one is looked for.

    Returns:
        The drape and its root mean square difference from the capture [m].
    """
    library = StateLibrary.of(simulator.cache, candidates[0].drape.mesh, fabric, scene)
    known = _distinct([*library.states(), *candidates])
    scored = [(state_distance(depth, c.drape, scene), n, c) for n, c in enumerate(known)]
    best = min(scored)[2]
    name = scene.setup.scene.value
    near = max((enough or {}).get(best.key, 0.0), math.sqrt(noise_square(scene) + GOOD_ENOUGH_M[name] ** 2))
    settled = name == "hanging" and bool(enough)  # its folds are noise: one search a fabric
    for _, _, start in [] if settled else sorted(scored)[: STARTS[name]]:
        if min(scored)[0] <= near:
            break
        led = simulator.led(start, fabric, scene, depth)
        if led.drape.ok:
            led = next((k for k in known if vertex_rms(k.drape, led.drape) < SAME_STATE_M), led)
            scored.append((state_distance(depth, led.drape, scene), len(scored), led))
    usable = [entry for entry in scored if entry[2].drape.ok] or scored
    rms, _, best = min(usable)
    library.add(best)
    return best, rms


def _distinct(states: list[KeyedDrape]) -> list[KeyedDrape]:
    """Without states that are the same as an earlier one."""
    kept: list[KeyedDrape] = []
    for state in states:
        if all(vertex_rms(state.drape, other.drape) >= SAME_STATE_M for other in kept):
            kept.append(state)
    return kept


def noise_square(scene: SimulationScene) -> float:
    """Variance of the sensor's stated noise [m²]."""
    return scene.sensor.range_noise_m**2 + scene.sensor.quantisation_m**2 / 12.0
