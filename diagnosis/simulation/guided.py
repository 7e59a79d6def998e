"""Let the solver find the equilibrium whose folds are those of a capture."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from diagnosis.measurement.level import levelled
from diagnosis.measurement.picture import picture_of
from diagnosis.scene import SimulationScene
from simcore.contact import PanelContact
from simcore.drape import Drape
from simcore.newton import Newton, NewtonOptions
from simcore.parameters import FabricParameters
from simcore.placement import Pins
from simcore.scenes import GRAVITY_M_S2
from simcore.solver import Solver

Array = NDArray[np.float64]
VISIBLE_M = 0.01
"""Of a vertex: its depth from the picture's, at most."""
SHOWN = 0.5
"""Of the smoothed picture where a vertex lies, what has to be data: holes, and what is outside it, lead nowhere."""
SPRINGS_PER_M = (1000.0, 300.0, 100.0, 30.0, 10.0)
"""Stiffness of the springs that hold a vertex at its seen height, in vertex weights a metre; one solve each."""


def relax_towards(
    solver: Solver,
    fabric: FabricParameters,
    scene: SimulationScene,
    start: Drape,
    target: Array,
    seen: NDArray[np.bool_],
) -> Array:
    """Positions near an equilibrium, reached with springs towards given heights that are weakened step by step.

    A free start from the capture's shape falls over the low ridges between fold states; held by springs, the cloth
    first finds its place in the plane.

    Args:
        solver: of the start's mesh.
        fabric, scene: what is simulated.
        start: positions to start from.
        target: positions whose z the springs pull to, [vertices, 3].
        seen: vertices that have a spring, bool [vertices].

    Returns:
        Positions [vertices, 3].
    """
    level = solver.levels[-1]
    grid, mechanics = level.grid, scene.mechanics
    pins = Pins.of(grid, scene.setup, np.zeros((len(scene.setup.pins_m), 3)))
    weight = fabric.density * GRAVITY_M_S2
    contact = PanelContact.of(grid.areas, weight, scene.setup.panel, mechanics.adhesion_pa, mechanics.adhesion_range_m)
    x = start.vertices.reshape(grid.shape).copy()
    pins.hold(x, 1.0)
    if scene.setup.panel:
        free = pins.fixed == 0
        x[..., 2][free] = np.maximum(x[..., 2][free], 2e-4)
    height = target[:, 2].reshape(grid.shape[:2])
    held = seen.reshape(grid.shape[:2]) * weight * grid.areas
    options = NewtonOptions(tolerance=2e-2, certify=False, iterations=40, largest_step=1.0)
    for spring in SPRINGS_PER_M:
        springs = replace(contact, spring=spring * held, height=height)
        level.set_up(fabric, mechanics, springs, pins.fixed)
        x = Newton(level, options, math.inf).minimise(x).x
    return np.asarray(x.reshape(-1, 3))


def warp_to_picture(
    drape: Drape, scene: SimulationScene, depth: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Vertices moved along their rays to the capture's levelled, lightly smoothed depth, and which of them are seen.

    Vertices that are hidden, or of which the picture shows nothing, stay. Returns positions [vertices, 3] in the panel
    frame and bool [vertices].
    """
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
    shown = ndimage.map_coordinates(weight, where, order=1, mode="constant") > SHOWN
    visible = shown & (np.abs(surface - points[:, 2]) < VISIBLE_M)
    moved = points * (1 + np.where(visible, move, 0.0) / points[:, 2])[:, None]
    vertices = (moved - pose[:3, 3]) @ pose[:3, :3]
    if scene.setup.panel:
        vertices[:, 2] = np.maximum(vertices[:, 2], 2e-4)
    return np.asarray(vertices), visible
