"""How a sample is put up: pins brought from the flat sheet to their places while the cloth swings to rest."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.grid import Grid
from simcore.level import Level
from simcore.mechanics import Jitter
from simcore.newton import FACTORISATIONS
from simcore.scenes import Setup

Array = NDArray[np.float64]
STEPS = 60
STEP_S = 0.03
LIFT_M = 4e-3
"""Height over the panel from which the flat sheet is put up [m]."""

_CORNERS = {"top_left": (0.0, 0.0), "top_right": (1.0, 0.0), "bottom_left": (0.0, 1.0), "bottom_right": (1.0, 1.0)}


@dataclass(frozen=True)
class Pins:
    """Held vertices of a grid and how they sit on their magnets.

    Attributes:
        fixed: int32 [rows, columns], 1 where held.
        owner: which pin holds a vertex (index in ``places``), -1 elsewhere.
        offset: a held vertex's place from its pin, flat on the panel [m], shape [rows, columns, 3].
        start, places: each pin's place before (flat sheet) and after it was brought home [m], shape [pins, 3].
    """

    fixed: NDArray[np.int32]
    owner: NDArray[np.int32]
    offset: Array
    start: Array
    places: Array

    @classmethod
    def of(cls, grid: Grid, setup: Setup, moves: Array) -> Pins:
        """Patches around the pinned corners; ``moves`` [pins, 3] are added to the stated places."""
        rest = grid.rest
        owner = np.full((grid.rows, grid.columns), -1, dtype=np.int32)
        offset = np.zeros(grid.shape)
        starts, places = [], []
        for number, (name, place) in enumerate(setup.pins_m.items()):
            across, down = _CORNERS[name]
            corner = rest[int(down * (grid.rows - 1)), int(across * (grid.columns - 1))]
            away = rest - corner
            held = np.linalg.norm(away, axis=2) <= setup.pin_radius_m + 1e-9
            owner[held] = number
            offset[held] = away[held]
            starts.append(corner)
            places.append(np.asarray(place) + moves[number])
        return cls((owner >= 0).astype(np.int32), owner, offset, np.array(starts), np.array(places))

    @property
    def overstretched(self) -> bool:
        """Two pins are farther apart than the cloth between them is long: tension, not gravity, shapes the drape."""
        apart = np.linalg.norm(self.places[:, None] - self.places[None], axis=2)
        cloth = np.linalg.norm(self.start[:, None] - self.start[None], axis=2)
        return bool((apart > cloth + 2e-3).any())

    def hold(self, x: Array, progress: float) -> None:
        """Move the held vertices of ``x`` to where they are at ``progress`` from 0 (flat) to 1 (home)."""
        held = self.owner >= 0
        at = (1.0 - progress) * self.start + progress * self.places
        x[held] = at[self.owner[held]] + self.offset[held]


@dataclass(frozen=True)
class Perturbation:
    """One repeat's random differences, drawn from a seed.

    Attributes:
        pin_moves: [pins, 3] [m].
        shape: random smooth functions on the sample, coefficients [4, 4, 4]: three force components and the lift.
        jitter: the scales they were drawn with.
    """

    pin_moves: Array
    shape: Array
    jitter: Jitter

    @classmethod
    def draw(cls, setup: Setup, jitter: Jitter, seed: np.random.SeedSequence) -> Perturbation:
        """Draw; the same seed gives the same numbers whatever the mesh."""
        rng = np.random.default_rng(seed)
        moves = np.zeros((len(setup.pins_m), 3))
        moves[:, :2] = jitter.pin_m * rng.standard_normal((len(setup.pins_m), 2)).clip(-2.5, 2.5)
        return cls(moves, rng.standard_normal((4, 4, 4)), jitter)

    def field(self, grid: Grid, component: int) -> Array:
        """A smooth random function of unit variance, shape [rows, columns]."""
        u = np.cos(np.pi * np.outer(np.arange(4), np.linspace(0.0, 1.0, grid.columns)))
        v = np.cos(np.pi * np.outer(np.arange(4), np.linspace(0.0, 1.0, grid.rows)))
        values: Array = np.einsum("ab,aj,bi->ji", self.shape[component], v, u)
        scale = float(np.sqrt(np.mean(values**2)))
        return values / scale if scale > 0.0 else values


def put_up(level: Level, pins: Pins, perturbation: Perturbation, deadline: float = math.inf) -> tuple[Array, int]:
    """Swing the sample from flat to near rest by implicit Euler steps (Baraff and Witkin 1998).

    The random forces die out while the pins come home.

    Args:
        level, pins, perturbation: what is put up, where it is held and how this time differs from others.
        deadline: CPU time of this process after which no further step is taken [s].

    Returns:
        Positions [rows, columns, 3] and the number of steps: fewer than :data:`STEPS` where time was up, or positions
        are not finite.
    """
    grid, jitter = level.grid, perturbation.jitter
    x = grid.rest.copy()
    lift = perturbation.field(grid, 3)
    x[..., 2] = LIFT_M + jitter.placement_m * (lift - lift.min()) / max(float(np.ptp(lift)), 1e-12)
    forces = np.stack([perturbation.field(grid, c) for c in range(3)], axis=2)
    forces *= jitter.force_weights * (level.loads.mass * 9.81)[..., None]
    velocity = np.zeros_like(x)
    inertia = level.loads.mass / STEP_S**2
    steps = 0
    for step in range(STEPS):
        if time.process_time() > deadline:
            break
        progress = min(1.0, (step + 1) / (0.5 * STEPS))
        level.push(forces * max(0.0, 1.0 - step / (0.6 * STEPS)))
        held = x.copy()
        pins.hold(held, progress)
        moved = _step(level, held, velocity, inertia, deadline)
        if moved is None:
            break
        velocity = 0.95 * (moved - x) / STEP_S
        x = moved
        steps += 1
    level.push(0.0)
    return x, steps


def _step(level: Level, x: Array, velocity: Array, inertia: Array, deadline: float) -> Array | None:
    """One step: a damped Newton step on elastic + inertial energy and up to two corrections with its factorisation.

    ``x``: positions with the held vertices where they are after the step. None where no step can be taken.
    """
    free = (level.fixed == 0)[..., None]
    goal = x + STEP_S * velocity * free
    for correction in range(3):
        gradient = level.gradient(x) + inertia[..., None] * (x - goal) * free
        if correction == 0 and not _factor(level, x, inertia, deadline):
            return None
        move = level.solve(-gradient)
        longest = 2.0 * level.grid.hu / max(float(np.abs(move).max()), 1e-12)
        length = min(1.0, longest, level.contact.largest_step(x, move, level.fixed))
        moved = x + length * move
        while level.own_contact is not None and not math.isfinite(level.own_contact.energy(moved)) and length > 1e-6:
            length *= 0.5
            moved = x + length * move
        x = moved
        if length == 1.0 and float(np.abs(move).max()) < 0.02 * level.grid.hu:
            break
    return x


def _factor(level: Level, x: Array, inertia: Array, deadline: float) -> bool:
    """Factor the Hessian with the inertia on its diagonal, raised fourfold where that is not enough; whether it went.

    It does not at positions that are not finite, nor when the time is up.
    """
    shift = inertia
    for _ in range(FACTORISATIONS):
        if level.factor(x, 0.0, shift, rough=True) == 0:
            return True
        if not np.isfinite(x).all() or time.process_time() > deadline:
            return False
        shift = 4.0 * shift
    return False
