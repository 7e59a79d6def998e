"""How the samples of a batch are put up together; see :mod:`simcore.placement`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from simcore.batch.cholesky import Factors
from simcore.batch.level import BatchLevel
from simcore.newton import FACTORISATIONS
from simcore.placement import LIFT_M, STEP_S, STEPS, Perturbation, Pins

Tensor = torch.Tensor


class BatchPins:
    """The held vertices of every cloth and their ways home."""

    def __init__(self, pins: Sequence[Pins], level: BatchLevel) -> None:
        start = np.zeros((len(pins), *level.grid.shape))
        home = np.zeros_like(start)
        for n, pin in enumerate(pins):
            held = pin.owner >= 0
            start[n][held] = pin.start[pin.owner[held]] + pin.offset[held]
            home[n][held] = pin.places[pin.owner[held]] + pin.offset[held]
        self._start, self._home = level.device.put(start), level.device.put(home)

    def hold(self, level: BatchLevel, which: Tensor, x: Tensor, progress: float) -> Tensor:
        """Positions with the held vertices where they are at ``progress`` from 0 (flat) to 1 (home)."""
        there = (1.0 - progress) * self._start[which] + progress * self._home[which]
        return torch.where(level.free[which], x, there)


def put_up(level: BatchLevel, pins: BatchPins, perturbations: Sequence[Perturbation], masses: np.ndarray) -> Tensor:
    """Swing all samples from flat to near rest.

    Args:
        level: the coarsest, set up.
        pins: of each cloth.
        perturbations: one a cloth.
        masses: of the vertices [b, rows, columns] [kg].

    Returns:
        Positions [b, rows, columns, 3].
    """
    grid, device = level.grid, level.device
    flat = np.repeat(grid.rest[None], len(perturbations), axis=0)
    pushes = np.zeros_like(flat)
    for n, random in enumerate(perturbations):
        lift = random.field(grid, 3)
        rise = random.jitter.placement_m * (lift - lift.min()) / max(float(np.ptp(lift)), 1e-12)
        flat[n, ..., 2] = LIFT_M + rise
        pushes[n] = np.stack([random.field(grid, c) for c in range(3)], axis=2)
        pushes[n] *= random.jitter.force_weights * (masses[n] * 9.81)[..., None]
    x, forces, inertia = device.put(flat), device.put(pushes), device.put(masses) / STEP_S**2
    for some in torch.split(torch.arange(len(x), device=x.device), level.most):
        x[some] = _swing(level, pins, some, x[some], forces, inertia[some])
    level.push(0.0)
    return x


def _swing(level: BatchLevel, pins: BatchPins, which: Tensor, x: Tensor, forces: Tensor, inertia: Tensor) -> Tensor:
    """Those at once."""
    velocity = torch.zeros_like(x)
    for step in range(STEPS):
        level.push(forces * max(0.0, 1.0 - step / (0.6 * STEPS)))
        previous = x
        x = pins.hold(level, which, x, min(1.0, (step + 1) / (0.5 * STEPS)))
        x = _step(level, which, x, velocity, inertia)
        velocity = 0.95 * (x - previous) / STEP_S
    return x


def _step(level: BatchLevel, which: Tensor, x: Tensor, velocity: Tensor, inertia: Tensor) -> Tensor:
    """One step of implicit Euler: a damped Newton step and up to two corrections with its factorisation."""
    free = level.free[which]
    goal = x + STEP_S * velocity * free
    live = torch.ones(len(x), dtype=torch.bool, device=x.device)
    factors: Factors | None = None
    for _ in range(3):
        gradient = level.gradients(which, x) + inertia[..., None] * (x - goal) * free
        if factors is None:
            factors = _positive(level, which, x, inertia)
        move = level.solve(factors, -gradient)
        size = move.abs().amax(dim=(1, 2, 3))
        length = torch.clamp(2.0 * level.grid.hu / size.clamp(min=1e-12), max=1.0)
        length = torch.minimum(length, level.largest_steps(which, x, move)) * live
        x = x + length[:, None, None, None] * move
        live = live & ~((length == 1.0) & (size < 0.02 * level.grid.hu))
        if not live.any():
            break
    return x


def _positive(level: BatchLevel, which: Tensor, x: Tensor, inertia: Tensor) -> Factors:
    """Factors with the inertia on the diagonal, raised fourfold where that is not enough; positions that are not finite
    have none."""
    nothing = torch.zeros(len(x), dtype=x.dtype, device=x.device)
    shift = inertia.clone()
    factors, good = level.factor(which, x, nothing, shift)
    pending = torch.nonzero(~good).ravel()
    for _ in range(FACTORISATIONS):
        pending = pending[torch.isfinite(x[pending]).all(dim=(1, 2, 3))]
        if not len(pending):
            break
        shift[pending] *= 4.0
        again, fine = level.factor(which[pending], x[pending], nothing[pending], shift[pending])
        factors.put(pending, again)
        pending = pending[~fine]
    return factors
