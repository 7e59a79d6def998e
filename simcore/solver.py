"""From a flat sample to a certified stable equilibrium."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simcore import friction, lang
from simcore.checks import check_request, seed_sequence
from simcore.contact import REACH_M, PanelContact
from simcore.crossings import count_crossings
from simcore.drape import Drape
from simcore.grid import Grid
from simcore.level import Level
from simcore.mechanics import Jitter, Mechanics
from simcore.memory import memory_told
from simcore.mesh import GridMesh, grid_triangles
from simcore.newton import Newton, NewtonOptions, Rest
from simcore.parameters import FabricParameters
from simcore.placement import Perturbation, Pins, put_up
from simcore.scenes import GRAVITY_M_S2, Setup
from simcore.self_contact import APART, TUCKED
from simcore.verdict import verdict

Array = NDArray[np.float64]
COARSEST_CELL_M = 0.02
OWN_CONTACT_STEP = 0.5
"""Cap on a vertex's move in one step where the cloth may touch itself [cells]."""

COARSE_STIFFNESS_N_M = 250.0
"""Largest stretch stiffness used on 20 mm cells while coarse levels look for the folds; grows as 1 / cell²."""


def softened(fabric: FabricParameters, grid: Grid, pins: Pins) -> FabricParameters:
    """The fabric with its stretch stiffnesses scaled down together, as a coarse grid needs them.

    A cell of size h bent to curvature k is strained by about (k h)² / 16: on coarse cells a stiff membrane resists
    folds that the sample has. Coarse levels only lead to a basin; the last level uses the fabric as it is, and so do
    all where the pins stretch the cloth.
    """
    if pins.overstretched:
        return fabric
    largest = COARSE_STIFFNESS_N_M * (COARSEST_CELL_M / grid.hu) ** 2
    stretch = (fabric.stretch_warp, fabric.stretch_weft, fabric.stretch_bias)
    scale = min(1.0, largest / max(stretch))
    warp, weft, bias = (max(1.0, scale * k) for k in stretch)
    return replace(fabric, stretch_warp=warp, stretch_weft=weft, stretch_bias=bias)


def cascade(mesh: GridMesh) -> list[Grid]:
    """Grids down to the mesh's own, each with about half the cell of the one before.

    The first has cells of 15 mm or more, or fewer than 16 of them along a side.
    """
    columns, rows = mesh.columns - 1, mesh.rows - 1
    grids = [Grid(rows + 1, columns + 1, mesh.resolution_m, mesh.resolution_m)]
    while grids[0].hu < 0.75 * COARSEST_CELL_M and min(rows, columns) >= 16:
        rows, columns = math.ceil(rows / 2), math.ceil(columns / 2)
        grids.insert(0, Grid(rows + 1, columns + 1, mesh.size_m[0] / columns, mesh.size_m[1] / rows))
    return grids


def prolong(x: Array, grid: Grid, degree: int = 3) -> Array:
    """Interpolation of positions to another grid of the same sample, bicubic or bilinear; shape [rows, columns, 3]."""
    from scipy.interpolate import RectBivariateSpline

    v, u = np.linspace(0, 1, x.shape[0]), np.linspace(0, 1, x.shape[1])
    fine_v, fine_u = np.linspace(0, 1, grid.rows), np.linspace(0, 1, grid.columns)
    return np.stack(
        [RectBivariateSpline(v, u, x[..., c], kx=degree, ky=degree)(fine_v, fine_u) for c in range(3)], axis=2
    )


@dataclass(frozen=True)
class _Problem:
    """What one call of :meth:`Solver.solve` asks for."""

    fabric: FabricParameters
    setup: Setup
    mechanics: Mechanics
    perturbation: Perturbation
    start: Drape | None
    deadline: float
    own_contact: int = 0


class Solver:
    """Compiled once for a mesh, reused for any fabric, set-up, seed and mechanics.

    Not thread-safe; one a process. Newton on a cascade of grids, starting from short implicit dynamics on the coarsest
    (see ``docs/conventions.md``).

    Raises:
        OutOfMemoryError: there was not enough memory.
    """

    def __init__(self, mesh: GridMesh) -> None:
        lang.start()
        self.mesh = mesh
        with memory_told(mesh):
            self.levels = [Level(grid) for grid in cascade(mesh)]

    def solve(
        self,
        fabric: FabricParameters,
        setup: Setup,
        *,
        seed: int | Sequence[int] | np.random.SeedSequence = 0,
        jitter: Jitter = Jitter(),
        mechanics: Mechanics = Mechanics(),
        start: Drape | None = None,
        time_limit_s: float | None = None,
    ) -> Drape:
        """Bring the sample to rest.

        Args:
            fabric: the seven parameters.
            setup: scene and pins, panel frame [m].
            seed: of the jitter; the same seed gives the same bits.
            jitter: scales of the differences between repeats.
            mechanics: optional physics.
            start: continue from this drape of the same mesh instead of putting the sample up afresh; the pins then
                move straight to their places and the jitter of forces and placement plays no part. Where it comes to
                rest through itself, contact with itself is switched on from this drape, never from flat: where this
                one crosses itself already, the answer is ``not_still``.
            time_limit_s: CPU seconds after which the best so far is returned as ``not_still``.

        Returns:
            The drape, with a status and a reason when it is not still.

        Raises:
            InputError: the set-up's sample is not the mesh's, its pins cannot hold it, ``start`` is of another mesh, or
                the seed is none.
            OutOfMemoryError: there was not enough memory.
        """
        check_request(self.mesh, setup, start, time_limit_s)
        began = time.process_time()
        deadline = math.inf if time_limit_s is None else began + time_limit_s
        perturbation = Perturbation.draw(setup, jitter, seed_sequence(seed))
        problem = _Problem(fabric, setup, mechanics, perturbation, start, deadline)
        with memory_told(self.mesh):
            return self._solve(problem, began)

    def _solve(self, problem: _Problem, began: float) -> Drape:
        rest, iterations = self._cascade(problem)
        energy = self.levels[-1].energy(rest.x)
        crossings = self._crossings(rest)
        for apart in (APART, TUCKED):
            if not crossings:
                break
            # few drapes touch themselves: those that would pass through are put up again with that contact on
            again, more = self._cascade(replace(problem, own_contact=apart))
            iterations += more
            if again.converged:
                rest, energy, crossings = again, self.levels[-1].energy(again.x), self._crossings(again)
        now = time.process_time()
        status, reason = verdict(self.mesh, self.levels[-1].cloths, rest, crossings, now > problem.deadline)
        vertices = rest.x.reshape(-1, 3)
        return Drape(self.mesh, vertices, status, rest.residual, energy, rest.stable, iterations, now - began, reason)

    def _cascade(self, problem: _Problem) -> tuple[Rest, int]:
        """From the flat sample, or where it starts, to rest on the last level, with the steps that took."""
        start = problem.start
        levels = self.levels if start is None else self.levels[-1:]
        x = None if start is None else np.array(start.vertices, np.float64, order="C").reshape(levels[-1].grid.shape)
        iterations = 0
        rest: Rest | None = None
        pressing: Array | None = None
        rubs = problem.mechanics.friction > 0.0 and problem.setup.panel
        for level in levels:
            x, count = self._begin(level, x, problem, pressing)
            iterations += count
            if problem.own_contact and problem.start is None and not math.isfinite(level.energy(x)):
                # interpolated, parts in touch cross: put up on these cells, which is slow but never lets them
                x, count = self._begin(level, None, problem)
                iterations += count
            if problem.own_contact and not math.isfinite(level.energy(x)):
                return Rest(x, math.inf, False, 0, False), iterations
            last = level is levels[-1]
            options = NewtonOptions() if last else NewtonOptions(tolerance=1e-2, certify=False, iterations=60)
            if problem.own_contact:
                options = replace(options, largest_step=OWN_CONTACT_STEP)
            rest = Newton(level, options, problem.deadline).minimise(x)
            if rubs:
                rest = friction.settle(level, rest, problem.mechanics.friction, options, problem.deadline)
                pressing = friction.pressure(level, rest.x)
            x = rest.x
            iterations += rest.iterations
            if not last:
                level.forget()
        assert rest is not None
        return rest, iterations

    def _begin(
        self, level: Level, x: Array | None, problem: _Problem, pressing: Array | None = None
    ) -> tuple[Array, int]:
        """Set a level up for the fabric and give it positions to start from, with the steps that took.

        ``pressing``: pressures on the panel where the level before came to rest [Pa], for friction.
        """
        grid, fabric, setup, mechanics = level.grid, problem.fabric, problem.setup, problem.mechanics
        perturbation = problem.perturbation
        pins = Pins.of(grid, setup, perturbation.pin_moves)
        contact = PanelContact.of(
            grid.areas, fabric.density * GRAVITY_M_S2, setup.panel, mechanics.adhesion_pa, mechanics.adhesion_range_m
        )
        if level is not self.levels[-1]:
            fabric = softened(fabric, grid, pins)
        level.set_up(fabric, mechanics, contact, pins.fixed, problem.own_contact)
        steps = 0
        if x is None:
            x, steps = put_up(level, pins, perturbation, problem.deadline)
        elif x.shape != grid.shape:
            x = self._refine(level, x, problem.own_contact)
        pins.hold(x, 1.0)
        if setup.panel:
            free = pins.fixed == 0
            x[..., 2][free] = np.maximum(x[..., 2][free], 0.2 * REACH_M)
        if mechanics.friction > 0.0 and setup.panel:
            # what presses holds where it is now: friction remembers how the sample was put up
            friction.hold(level, x, mechanics.friction, pressing)
        return x, steps

    def _refine(self, level: Level, x: Array, own_contact: int) -> Array:
        """Positions on a finer level: smooth, or along the coarse cells where parts in touch would cross otherwise."""
        smooth = prolong(x, level.grid)
        if own_contact and count_crossings(smooth.reshape(-1, 3), grid_triangles(level.grid.rows, level.grid.columns)):
            return prolong(x, level.grid, degree=1)
        return smooth

    def _crossings(self, rest: Rest) -> int:
        """Edges of a drape at rest that pierce its triangles."""
        return count_crossings(rest.x.reshape(-1, 3), self.mesh.triangles) if rest.converged else 0
