"""Newton's method to a certified minimum on one level."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.inner import inner, norm
from simcore.level import Level

Array = NDArray[np.float64]

INNER_STEPS = 32
"""Most L-BFGS steps with one factorisation."""
MEMORY = 6
"""Pairs that L-BFGS keeps."""
WORTH = 0.03
"""An L-BFGS step that lowers the energy by less than this share of the factorisation's own step is the last."""
FACTORISATIONS = 40
"""Most that are made for one step, each with a lower blend or four times the damping of the one before."""
GOES_ON_BELOW = 20.0
"""Below so many tolerances an inner run to a certified rest goes on, however little the energy falls."""
FAR = 1.0
"""Residual over which the blend on the way to a certified rest stays at :data:`FAR_BLEND` [vertex weights]."""
FAR_BLEND = 0.5
ROUGH_FROM = 0.002
"""Residual over which single precision is enough for a direction [vertex weights]."""


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
    finish is quadratic. A factorisation costs several times a solve, so each is used for a run of L-BFGS steps. A
    stationary point with negative curvature is left along its lowest mode.
    """

    def __init__(self, level: Level, options: NewtonOptions, deadline: float = math.inf) -> None:
        self.level = level
        self.options = options
        self.deadline = deadline
        rng = np.random.default_rng(7)
        self._start: Array = rng.standard_normal((4, level.fixed.size * 3))
        self.escapes = 0

    def minimise(self, x: Array) -> Rest:
        """Go down from ``x`` (which must not be behind the panel)."""
        level, options = self.level, self.options
        blend, damping = 0.0, 0.0
        energy, gradient = level.energy(x), level.gradient(x)
        residual = level.residual(gradient)
        for iteration in range(options.iterations + 1):
            if not math.isfinite(residual):
                break
            near = residual < options.tolerance
            if near and not options.certify:
                return Rest(x, residual, False, iteration, True)
            if near:
                blend, damping = 1.0, 0.0
            last = iteration == options.iterations  # what is near then is still judged
            if (last and not near) or time.process_time() > self.deadline:
                break
            if options.certify and residual > FAR:
                blend = min(blend, FAR_BLEND)
            rough = residual > ROUGH_FROM
            negative = self._factor(x, blend, damping, rough)
            if near and negative == 0:
                return Rest(x, residual, True, iteration, True)
            if near:
                self.escapes += 1
                if last or self.escapes > 8:
                    break
                x = self._escape(x, energy)
                energy, gradient = level.energy(x), level.gradient(x)
                residual, blend = level.residual(gradient), 0.5
                continue
            refused, tries = blend, 1
            while negative > 0:
                if tries == FACTORISATIONS or time.process_time() > self.deadline:
                    return Rest(x, residual, False, iteration, False)
                tries += 1
                if blend > 0.0:
                    blend = 0.5 * blend if blend > 0.1 else 0.0
                else:
                    damping = max(4.0 * damping, 1e-3)
                negative = self._factor(x, blend, damping, rough)
            refused = refused if refused > blend else 2.0
            slope, length, fall, x, energy, gradient = self._descend(x, energy, gradient)
            residual = level.residual(gradient)
            if length == 0.0:
                if blend == 0.0 and damping > 1e3:
                    break
                blend, damping = 0.0, max(4.0 * damping, 1e-3)
                continue
            if length == 1.0 and fall > -0.25 * slope:
                blend = min(1.0, 2.0 * blend + 0.25) if refused > 1.5 else blend * 1.25
                damping = 0.25 * damping if damping > 1e-3 else 0.0
            elif length < 0.3:
                blend *= 0.5
        return Rest(x, residual, False, iteration, False)

    def _descend(self, x: Array, energy: float, gradient: Array) -> tuple[float, float, float, Array, float, Array]:
        """One step with the factorisation at hand, then as many limited-memory BFGS steps preconditioned by it as pay.

        Returns:
            Of the first step the slope, its length and its fall of energy; then positions, energy and gradient.
        """
        level = self.level
        pairs: list[tuple[Array, Array, float]] = []
        first: tuple[float, float, float] | None = None
        for _ in range(INNER_STEPS):
            step = self._direction(gradient, pairs)
            slope = inner(gradient, step)
            length, moved, new_energy = self._search(x, step, energy, slope)
            fall = energy - new_energy
            if first is None:
                first = (slope, length, fall)
                worth = fall * WORTH
            if length == 0.0:
                break
            new_gradient = level.gradient(moved)
            s, y = moved - x, new_gradient - gradient
            curvature = inner(s, y)
            if curvature > 1e-12 * norm(s) * norm(y):
                pairs.append((s, y, 1.0 / curvature))
                del pairs[:-MEMORY]
            x, energy, gradient = moved, new_energy, new_gradient
            residual = level.residual(gradient)
            goes_on = self.options.certify and residual < GOES_ON_BELOW * self.options.tolerance
            if (fall < worth and not goes_on) or length < 0.1 or residual < self.options.tolerance:
                break
        assert first is not None
        return (*first, x, energy, gradient)

    def _direction(self, gradient: Array, pairs: list[tuple[Array, Array, float]]) -> Array:
        """L-BFGS two-loop recursion (Nocedal and Wright 2006, algorithm 7.4) round the factored Hessian."""
        q = gradient.copy()
        weights = []
        for s, y, rho in reversed(pairs):
            alpha = rho * inner(s, q)
            q -= alpha * y
            weights.append(alpha)
        z = self.level.solve(q)
        for (s, y, rho), alpha in zip(pairs, reversed(weights), strict=True):
            z += (alpha - rho * inner(y, z)) * s
        return -z

    def _factor(self, x: Array, blend: float, damping: float, rough: bool) -> int:
        return self.level.factor(x, blend, damping * self.level.loads.weight / self.level.grid.hu, rough)

    def _escape(self, x: Array, energy: float) -> Array:
        """Leave a saddle along its lowest mode, to whichever side and as far as the energy falls.

        The mode is sought from a Hessian shifted just enough to be positive: nearest zero may lie other ones.
        """
        level = self.level
        shift = 1e-4
        while self._factor(x, 1.0, shift, False) > 0 and shift < 1e3:
            if time.process_time() > self.deadline:
                return x
            shift *= 4.0
        _, modes = level.soft_modes(4, self._start, 10)
        mode = modes[0].reshape(x.shape) / np.abs(modes[0]).max()
        best, best_energy = x, energy
        for sign in (1.0, -1.0):
            direction = sign * mode
            cap = min(level.contact.largest_step(x, direction, level.fixed), 3.0 * level.grid.hu)
            size = 1e-3 * level.grid.hu
            while size < cap:
                candidate = x + size * direction
                value = level.energy(candidate)
                if value < best_energy:
                    best, best_energy = candidate, value
                elif size > 0.1 * level.grid.hu:
                    break
                size *= 2.0
        return best

    def _search(self, x: Array, step: Array, energy: float, slope: float) -> tuple[float, Array, float]:
        """Backtrack from the longest allowed step until the energy falls enough; 0 when it never does.

        The next length is where a parabola through the slope and the last energy is lowest, within a tenth to a half.
        """
        level = self.level
        if slope >= 0.0:
            return 0.0, x, energy
        longest = self.options.largest_step * min(level.grid.hu, level.grid.hv)
        length = min(1.0, longest / float(np.abs(step).max()))
        slack = 1e-13 * abs(energy)
        for _ in range(30):
            moved = level.contact.keep_clear(x, x + length * step, level.fixed)
            new_energy = level.energy(moved)
            if new_energy <= energy + 1e-4 * length * slope + slack:
                return length, moved, new_energy
            share = 0.5
            if math.isfinite(new_energy):
                share = max(0.1, min(0.5, -0.5 * slope * length / (new_energy - energy - slope * length)))
            length *= share
        return 0.0, x, energy
