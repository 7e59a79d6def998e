"""Friction on the panel: what presses holds where it was when its level began, by as much as it presses at rest.

The bound of friction, coefficient times normal force, is kept fixed while Newton goes down (lagged), then taken anew
from where it ended, until it no longer changes; the place it holds to stays. Formula: ``docs/conventions.md``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from simcore.grid import Grid
from simcore.level import Level
from simcore.newton import Newton, NewtonOptions, Rest

Array = NDArray[np.float64]

ROUNDS = 8
"""Most times that the normal forces are taken anew, and judged after each; two or three are usual."""
SETTLED = 0.05
"""Sum of the normal forces' changes, as a share of their sum, below which they are settled."""


def pressure(level: Level, x: Array) -> Array:
    """What presses on the panel at each vertex [Pa], shape [rows, columns]; of use where ``x`` is at rest."""
    return level.contact.normal_force(x, level.fixed) / level.grid.areas


def hold(level: Level, x: Array, coefficient: float, pressing: Array | None) -> None:
    """Let the panel hold the cloth at ``x`` from now on.

    Args:
        level: set up, with a panel.
        x: positions, shape [rows, columns, 3].
        coefficient: of friction.
        pressing: pressures at rest on another grid of the sample [Pa]; None takes them from ``x``.
    """
    if pressing is None:
        force = level.contact.normal_force(x, level.fixed)
    else:
        force = _elsewhere(pressing, level.grid) * level.grid.areas * (level.fixed == 0)
    level.touch(replace(level.contact, friction_force=coefficient * force, anchor=x[..., :2].copy()))


def settle(level: Level, rest: Rest, coefficient: float, options: NewtonOptions, deadline: float) -> Rest:
    """Bring the normal forces of a level that is at rest to those that friction was bounded by.

    Returns:
        Where it ended, all steps counted; not converged where the forces did not settle.
    """
    for taken in range(ROUNDS + 1):
        bound = level.contact.friction_force
        if not rest.converged or bound is None:
            return rest
        now = coefficient * level.contact.normal_force(rest.x, level.fixed)
        if float(np.abs(now - bound).sum()) <= SETTLED * float(now.sum()):
            return rest
        if taken == ROUNDS:
            break
        level.touch(replace(level.contact, friction_force=now))
        more = Newton(level, options, deadline).minimise(rest.x.copy())
        rest = replace(more, iterations=rest.iterations + more.iterations)
    return replace(rest, converged=False)


def _elsewhere(pressing: Array, grid: Grid) -> Array:
    """Pressures on another grid of the same sample, bilinear [Pa]."""
    v, u = np.linspace(0, 1, pressing.shape[0]), np.linspace(0, 1, pressing.shape[1])
    spline = RectBivariateSpline(v, u, pressing, kx=1, ky=1)
    return np.asarray(spline(np.linspace(0, 1, grid.rows), np.linspace(0, 1, grid.columns)))
