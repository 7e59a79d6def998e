"""Newton's method for a batch, each cloth at its own pace. Same rules as :mod:`simcore.newton`."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from simcore.batch.cholesky import Factors
from simcore.batch.level import BatchLevel
from simcore.newton import FACTORISATIONS, INNER_STEPS, MEMORY, WORTH, NewtonOptions

Tensor = torch.Tensor
ESCAPES = 8
NEVER = 2.0
"""More than any blend."""
WAIT = 8
"""Cloths begin together when they are one in so many of all that there is room for, and leave saddles together when
they are one in so many of those on their way."""
FEW = 0.5
"""Where no more than this share of the cloths still profit from a factorisation, the next one is due for all."""


@dataclass
class BatchRest:
    """Where Newton ended, for each cloth of the batch.

    Attributes:
        x: positions [b, rows, columns, 3].
        residual: [vertex weights], [b].
        stable: the exact Hessian is positive definite there.
        iterations: steps taken.
        converged: residual below the tolerance (and stable, when that was asked for).
    """

    x: Tensor
    residual: Tensor
    stable: Tensor
    iterations: Tensor
    converged: Tensor


@dataclass
class _State:
    """The cloths still on their way.

    ``refused`` is the blend whose matrix was not positive definite since the last step, or :data:`NEVER`; ``steps`` are
    those taken, ``escapes`` the saddles left.
    """

    which: Tensor
    x: Tensor
    energy: Tensor
    gradient: Tensor
    residual: Tensor
    blend: Tensor
    damping: Tensor
    refused: Tensor
    escapes: Tensor
    steps: Tensor

    def keep(self, mask: Tensor) -> None:
        for name, value in vars(self).items():
            setattr(self, name, value[mask])

    def join(self, others: _State) -> None:
        for name, value in vars(self).items():
            setattr(self, name, torch.cat([value, getattr(others, name)]))


class BatchNewton:
    """Blended Newton: H = H_spd + blend (H_exact - H_spd), with limited-memory BFGS steps between factorisations."""

    def __init__(self, level: BatchLevel, options: NewtonOptions) -> None:
        self.level = level
        self.options = options

    def minimise(self, x: Tensor) -> BatchRest:
        """Go down from ``x`` [b, rows, columns, 3], of which nothing is behind the panel.

        As many at once as the level has room for; others take the places of those at rest, so that the few that take
        long do not keep a device waiting. For the same reason saddles are left by several cloths together.
        """
        count = len(x)
        flags = torch.zeros(count, dtype=torch.bool, device=x.device)
        steps = torch.zeros(count, dtype=torch.int64, device=x.device)
        rest = BatchRest(x.clone(), torch.zeros(count, dtype=x.dtype, device=x.device), flags, steps, flags.clone())
        waiting = torch.arange(count, device=x.device)
        state = self._begin(waiting[:0], x[:0])
        stuck = self._begin(waiting[:0], x[:0])
        while len(waiting) or len(state.which) or len(stuck.which):
            room = self.level.most - len(state.which) - len(stuck.which)
            if len(waiting) and WAIT * room >= self.level.most:
                state.join(self._begin(waiting[:room], x[waiting[:room]]))
                waiting = waiting[room:]
            if len(stuck.which) and WAIT * len(stuck.which) >= len(state.which):
                self._escape(stuck)
                state.join(stuck)
                stuck.keep(torch.zeros_like(stuck.escapes, dtype=torch.bool))
            self._leave(state, rest)
            if len(state.which):
                self._iterate(state, stuck, rest)
        return rest

    def _begin(self, which: Tensor, x: Tensor) -> _State:
        level = self.level
        gradient = level.gradients(which, x)
        zero = torch.zeros(len(x), dtype=x.dtype, device=x.device)
        none = torch.zeros(len(x), dtype=torch.int64, device=x.device)
        return _State(
            which, x, level.energies(which, x), gradient, level.residuals(which, gradient), zero, zero.clone(),
            torch.full_like(zero, NEVER), none, none.clone(),
        )  # fmt: skip

    def _leave(self, state: _State, rest: BatchRest) -> None:
        """Write down how far all are; let those go that never will be at rest, or are and need not be certified.

        What is near after the last step stays for one more factorisation, which judges it.
        """
        options = self.options
        near = state.residual < options.tolerance
        rest.x[state.which], rest.residual[state.which] = state.x, state.residual
        rest.iterations[state.which] = state.steps
        done = torch.zeros_like(state.which, dtype=torch.bool)
        if not options.certify:
            done = near
        rest.converged[state.which] = done
        state.keep(~(done | ~torch.isfinite(state.residual) | ((state.steps >= options.iterations) & ~near)))

    def _iterate(self, state: _State, stuck: _State, rest: BatchRest) -> None:
        """One factorisation and what is made of it; cloths at rest leave the state, those on saddles go to ``stuck``.

        A cloth whose matrix is not positive definite tries a lower blend, then more damping, in the next iteration.
        """
        level, spent = self.level, state.steps >= self.options.iterations
        near = state.residual < self.options.tolerance
        state.blend[near], state.damping[near] = 1.0, 0.0
        shift = state.damping * level.weights[state.which] / level.grid.hu
        factors, good = level.factor(state.which, state.x, state.blend, shift)
        done, saddle = near & good, near & ~good
        rest.stable[state.which[done]] = True
        rest.converged[state.which[done]] = True
        going = good & ~near
        slope, length, fall = self._descend(state, factors, going)
        broken = going & (length == 0.0) & (state.blend == 0.0)
        broken = (broken | ~good) & (state.damping > 1e3)
        self._adapt(state, going, slope, length, fall)
        self._ease(state, ~good & ~near)
        state.steps[good | near] += 1
        state.escapes[saddle] += 1
        left = done | broken | (saddle & spent) | (state.escapes > ESCAPES)
        others = _State(**vars(state))
        others.keep(saddle & ~left)
        stuck.join(others)
        state.keep(~(saddle | left))

    def _ease(self, state: _State, bad: Tensor) -> None:
        """Lower blends, then raise damping, where the matrix was not positive definite."""
        at = bad & (state.refused == NEVER) & (state.blend > 0.0)  # what damping cures refuses no blend
        state.refused = torch.where(at, state.blend, state.refused)
        lowered = torch.where(state.blend > 0.1, 0.5 * state.blend, 0.0)
        raised = torch.clamp(4.0 * state.damping, min=1e-3)
        state.damping = torch.where(bad & (state.blend == 0.0), raised, state.damping)
        state.blend = torch.where(bad, lowered, state.blend)

    def _adapt(self, state: _State, going: Tensor, slope: Tensor, length: Tensor, fall: Tensor) -> None:
        """Blend and damping of the next step, for those that took one."""
        stuck = going & (length == 0.0)
        state.damping[stuck] = torch.clamp(4.0 * state.damping[stuck], min=1e-3)
        state.blend[stuck] = 0.0
        well = going & (length == 1.0) & (fall > -0.25 * slope)
        quick = torch.clamp(2.0 * state.blend + 0.25, max=1.0)
        grown = torch.where(state.refused == NEVER, quick, 1.25 * state.blend)
        state.blend = torch.where(well, grown, state.blend)
        eased = torch.where(state.damping > 1e-3, 0.25 * state.damping, torch.zeros_like(state.damping))
        state.damping = torch.where(well, eased, state.damping)
        short = going & (length > 0.0) & (length < 0.3)
        state.blend = torch.where(short, 0.5 * state.blend, state.blend)
        state.refused = torch.where(going, NEVER, state.refused)

    def _descend(self, state: _State, factors: Factors, going: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """One step with each factorisation, then as many limited-memory BFGS steps preconditioned by it as pay.

        Returns:
            Of the first step slope, length and fall of energy, each [n]; the state is moved.
        """
        level = self.level
        pairs: list[tuple[Tensor, Tensor, Tensor]] = []
        first: tuple[Tensor, Tensor, Tensor] | None = None
        worth = torch.zeros_like(state.energy)
        live = going.clone()
        for _ in range(INNER_STEPS):
            if live.sum() <= FEW * going.sum():
                break
            step = self._direction(factors, state.gradient, pairs)
            slope = _inner(state.gradient, step)
            length, moved, energy = self._search(state, step, slope, live)
            fall = torch.where(live, state.energy - energy, torch.zeros_like(energy))
            if first is None:
                first, worth = (slope, length, fall), WORTH * fall
            went = live & (length > 0.0)
            gradient = level.gradients(state.which, moved)
            s, y = moved - state.x, gradient - state.gradient
            curvature = _inner(s, y)
            useful = went & (curvature > 1e-12 * torch.sqrt(_inner(s, s) * _inner(y, y)))
            pairs = [*pairs, (s, y, torch.where(useful, 1.0 / curvature, 0.0))][-MEMORY:]
            state.x = torch.where(went[:, None, None, None], moved, state.x)
            state.gradient = torch.where(went[:, None, None, None], gradient, state.gradient)
            state.energy = torch.where(went, energy, state.energy)
            state.residual = level.residuals(state.which, state.gradient)
            live = went & (fall >= worth) & (length >= 0.1) & (state.residual >= self.options.tolerance)
        if first is None:
            zero = torch.zeros_like(state.energy)
            return zero, zero, zero
        return first

    def _direction(self, factors: Factors, gradient: Tensor, pairs: list[tuple[Tensor, Tensor, Tensor]]) -> Tensor:
        """L-BFGS two-loop recursion (Nocedal and Wright 2006, algorithm 7.4) round the factored Hessians."""
        q = gradient.clone()
        shares = []
        for s, y, rho in reversed(pairs):
            alpha = rho * _inner(s, q)
            q = q - alpha[:, None, None, None] * y
            shares.append(alpha)
        z = self.level.solve(factors, q)
        for (s, y, rho), alpha in zip(pairs, reversed(shares), strict=True):
            z = z + (alpha - rho * _inner(y, z))[:, None, None, None] * s
        return -z

    def _search(self, state: _State, step: Tensor, slope: Tensor, live: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Backtrack each live cloth from its longest step until the energy falls enough; 0 when it never does.

        The next length is where a parabola through the slope and the last energy is lowest, within a tenth to a half.
        """
        level = self.level
        longest = self.options.largest_step * min(level.grid.hu, level.grid.hv)
        tried = torch.clamp(longest / step.abs().amax(dim=(1, 2, 3)).clamp(min=1e-300), max=1.0)
        length = torch.zeros_like(slope)
        moved, energy = state.x.clone(), state.energy.clone()
        slack = 1e-13 * state.energy.abs()
        pending = torch.nonzero(live & (slope < 0.0)).ravel()
        for _ in range(30):
            if not len(pending):
                break
            which, x = state.which[pending], state.x[pending]
            there = level.keep_clear(which, x, x + tried[pending][:, None, None, None] * step[pending])
            value = level.energies(which, there)
            enough = value <= state.energy[pending] + 1e-4 * tried[pending] * slope[pending] + slack[pending]
            took = pending[enough]
            length[took], moved[took], energy[took] = tried[took], there[enough], value[enough]
            pending, over = pending[~enough], value[~enough] - state.energy[pending[~enough]]
            drop = tried[pending] * slope[pending]
            share = (-0.5 * drop / (over - drop)).clamp(min=0.1, max=0.5)
            tried[pending] *= torch.where(torch.isfinite(over), share, 0.5)
        return length, moved, energy

    def _escape(self, state: _State) -> None:
        """Leave saddles along their lowest modes, to whichever side and as far as the energy falls."""
        level, which, x = self.level, state.which, state.x
        mode = self._lowest_modes(which, x)
        best, least = x.clone(), state.energy.clone()
        for sign in (1.0, -1.0):
            direction = sign * mode
            cap = torch.clamp(level.largest_steps(which, x, direction), max=3.0 * level.grid.hu)
            size, falling = 1e-3 * level.grid.hu, torch.ones_like(which, dtype=torch.bool)
            while size < 3.0 * level.grid.hu and falling.any():
                candidate = x + size * direction
                value = level.energies(which, candidate)
                better = (value < least) & falling & (cap > size)
                best[better], least[better] = candidate[better], value[better]
                falling &= better | (size <= 0.1 * level.grid.hu)
                size *= 2.0
        state.x, state.energy = best, least
        state.gradient = level.gradients(which, best)
        state.residual = level.residuals(which, state.gradient)
        state.blend = torch.full_like(state.blend, 0.5)

    def _lowest_modes(self, which: Tensor, x: Tensor) -> Tensor:
        """Lowest eigenvectors, by inverse iteration with Hessians shifted just enough to be positive."""
        level = self.level
        ones = torch.ones(len(which), dtype=x.dtype, device=x.device)
        shift, unit = 1e-4 * ones, level.weights[which] / level.grid.hu
        factors, good = level.factor(which, x, ones, shift * unit)
        pending = torch.nonzero(~good).ravel()
        for _ in range(FACTORISATIONS):
            if not len(pending):
                break
            shift[pending] *= 4.0
            again, fine = level.factor(which[pending], x[pending], ones[pending], (shift * unit)[pending])
            factors.put(pending, again)
            pending = pending[~fine]
        generator = torch.Generator().manual_seed(7)
        start = torch.randn(x.shape[1:], generator=generator, dtype=torch.float64).to(x.device)
        mode: Tensor = start.expand(x.shape) * level.free[which]
        for _ in range(20):
            mode = level.solve(factors, mode)
            mode = mode / mode.abs().amax(dim=(1, 2, 3), keepdim=True)
        return mode


def _inner(a: Tensor, b: Tensor) -> Tensor:
    products: Tensor = (a * b).sum(dim=(1, 2, 3))
    return products
