"""Let the solver find the equilibrium whose folds are those of a capture."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simcore.scenes import GRAVITY_M_S2

if TYPE_CHECKING:
    from diagnosis.scene import SimulationScene
    from simcore.drape import Drape
    from simcore.parameters import FabricParameters
    from simcore.solver import Solver

Array = NDArray[np.float64]
SPRINGS_PER_M = (1000.0, 300.0, 100.0, 30.0, 10.0)
"""Stiffness of the springs that hold a vertex at its seen height, in vertex weights a metre; one solve each."""


def relax_towards(
    solver: Solver,
    fabric: FabricParameters,
    scene: SimulationScene,
    start: Drape,
    target: Array,
    seen: NDArray[np.bool_],
    *,
    release: bool = True,
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
        release: weaken the springs; otherwise stop with the strongest.

    Returns:
        Positions [vertices, 3].
    """
    from simcore.contact import PanelContact
    from simcore.newton import Newton, NewtonOptions
    from simcore.placement import Pins

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
    for spring in SPRINGS_PER_M if release else SPRINGS_PER_M[:1]:
        springs = replace(contact, spring=spring * held, height=height)
        level.set_up(fabric, mechanics, springs, pins.fixed)
        x = Newton(level, options, math.inf).minimise(x).x
    return np.asarray(x.reshape(-1, 3))
