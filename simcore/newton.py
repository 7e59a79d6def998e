"""Newton's method to a certified minimum on one level."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.level import Level

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NewtonOptions:
    """How far and how long.

    Attributes:
        tolerance: residual to reach [vertex weights].
        certify: require that the exact Hessian has no negative eigenvalue at the end.
        iterations: most Newton steps.
        largest_step: cap on a vertex's move in one step, in cells.
    """

    tolerance: float = 5e-4
    certify: bool = True
    iterations: int = 200
    largest_step: float = 3.0


@dataclass(frozen=True)
class Rest:
    """Where Newton ended.

    Attributes:
        x: positions, shape [rows, columns, 3].
        residual: [vertex weights].
        stable: the exact Hessian was factored here and has no negative eigenvalue.
        iterations: steps taken.
        converged: residual below the tolerance (and stable, when that was asked for).
    """

    x: Array
    residual: float
    stable: bool
    iterations: int
    converged: bool


class Newton:
    """Blended Newton: H = H_spd + blend (H_exact - H_spd).

    The blend grows while steps do as predicted and shrinks when the factorisation meets negative eigenvalues; at 1 the
    finish is quadratic. A stationary point with negative curvature is left along its lowest mode.
    """

    def __init__(self, level: Level, options: NewtonOptions, deadline: float = math.inf) -> None:
        self.level = level
        self.options = options
        self.deadline = deadline

    def minimise(self, x: Array) -> Rest:
        """Go down from ``x`` (which must not be behind the panel)."""
        level, options = self.level, self.options
        blend, damping, escapes = 0.0, 0.0, 0
        energy, gradient = level.energy(x), level.gradient(x)
        residual = level.residual(gradient)
        for iteration in range(options.iterations + 1):
            near = residual < options.tolerance
            if near and not options.certify:
                return Rest(x, residual, False, iteration, True)
            if near:
                blend, damping = 1.0, 0.0
            negative = level.factor(x, blend, damping * level.loads.weight / level.grid.hu)
            if near and negative == 0:
                return Rest(x, residual, True, iteration, True)
            if iteration == options.iterations or time.process_time() > self.deadline:
                break
            if near:
                escapes += 1
                if escapes > 8:
                    break
                x = self._escape(x, energy)
                energy, gradient = level.energy(x), level.gradient(x)
                residual, blend = level.residual(gradient), 0.5
                continue
            while negative > 0:
                if blend > 0.0:
                    blend = 0.5 * blend if blend > 0.1 else 0.0
                else:
                    damping = max(4.0 * damping, 1e-3)
                negative = level.factor(x, blend, damping * level.loads.weight / level.grid.hu)
            step = level.solve(-gradient)
            length, moved, new_energy = self._search(x, step, energy, gradient)
            if length == 0.0:
                if blend == 0.0 and damping > 1e3:
                    break
                blend, damping = 0.0, max(4.0 * damping, 1e-3)
                continue
            predicted = -float(np.vdot(gradient, step)) * length * (1.0 - 0.5 * length)
            ratio = (energy - new_energy) / max(predicted, 1e-300)
            x, energy = moved, new_energy
            gradient = level.gradient(x)
            residual = level.residual(gradient)
            if length == 1.0 and ratio > 0.5:
                blend = min(1.0, 2.0 * blend + 0.25)
                damping = 0.25 * damping if damping > 1e-3 else 0.0
            elif length < 0.3:
                blend *= 0.5
        return Rest(x, residual, False, options.iterations, False)

    def _search(self, x: Array, step: Array, energy: float, gradient: Array) -> tuple[float, Array, float]:
        """Backtrack from the longest allowed step until the energy falls enough; 0 when it never does."""
        level = self.level
        slope = float(np.vdot(gradient, step))
        if slope >= 0.0:
            return 0.0, x, energy
        longest = self.options.largest_step * min(level.grid.hu, level.grid.hv)
        length = min(1.0, longest / float(np.abs(step).max()), level.contact.largest_step(x, step, level.fixed))
        slack = 1e-13 * abs(energy)
        for _ in range(30):
            moved = x + length * step
            new_energy = level.energy(moved)
            if new_energy <= energy + 1e-4 * length * slope + slack:
                return length, moved, new_energy
            length *= 0.5
        return 0.0, x, energy

    def _escape(self, x: Array, energy: float) -> Array:
        """Step along the lowest mode of the exact Hessian, to whichever side the energy falls further."""
        level = self.level
        shift = level.loads.weight / level.grid.hu * 1e-2
        while level.factor(x, 1.0, shift) > 0:
            shift *= 4.0
        mode = np.cos(np.arange(x.size) * 1.7).reshape(x.shape) * (level.fixed == 0)[..., None]
        for _ in range(30):
            mode = level.solve(mode)
            mode /= np.linalg.norm(mode)
        mode /= np.abs(mode).max()
        best, best_energy = x, energy
        size = min(level.grid.hu, level.grid.hv)
        for sign in (1.0, -1.0):
            cap = level.contact.largest_step(x, sign * mode, level.fixed)
            for fraction in (1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001):
                candidate = x + sign * min(fraction * size, cap) * mode
                value = level.energy(candidate)
                if value < best_energy:
                    best, best_energy = candidate, value
        return best
