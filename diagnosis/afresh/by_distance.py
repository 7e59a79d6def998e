"""How far captures are from simulations with effects on, for one simulation each: to choose what is sought."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.fresh import FreshLook, Sized
from diagnosis.afresh.side_by_side import side_by_side
from diagnosis.measurement.picture import state_distance
from diagnosis.scene import SimulationScene
from diagnosis.simulation.simulator import KeyedDrape
from diagnosis.tasks.fabric_task import CaptureResult
from diagnosis.workers import ALONE, Workers

Array = NDArray[np.float64]
Start = Callable[[FreshLook, CaptureResult], tuple[KeyedDrape, SimulationScene]]
"""The state from which a simulation of a capture goes on, and the scene in which it does."""


def squares(
    looks: Mapping[str, FreshLook], trials: Sequence[Sequence[Sized]], scene: str, workers: Workers = ALONE
) -> Array:
    """Square distances of each fabric's first capture of a scene from simulations [m²], [trials, fabrics].

    Args:
        looks: by fabric; they learn nothing of the last effects.
        trials: effects, of which the last comes on where the others are as :meth:`FreshLook.drape` knows them.
        scene: whose captures.
        workers: that simulate fabrics side by side.

    Returns:
        Infinite where the cloth does not come to rest or a fabric has no such capture.
    """
    return squares_from(looks, [partial(_come_on, effects=effects) for effects in trials], scene, workers)


def squares_from(
    looks: Mapping[str, FreshLook], starts: Sequence[Start], scene: str, workers: Workers = ALONE
) -> Array:
    """The same from what states turn into in other scenes [m²], [starts, fabrics].

    Args:
        looks: by fabric.
        starts: see :data:`Start`; what runs in another process must be picklable.
        scene: whose captures.
        workers: that simulate fabrics side by side.
    """
    work = partial(_squares, starts=starts, scene=scene)
    return np.stack(side_by_side(work, list(looks.values()), workers), axis=1)


def known_squares(
    looks: Mapping[str, FreshLook], effects: Sequence[Sized], scene: str, workers: Workers = ALONE
) -> Array:
    """The same from the nearest simulations with effects on, as :meth:`FreshLook.drape` finds them [m²], [fabrics]."""
    work = partial(_known_square, effects=effects, scene=scene)
    return np.array(side_by_side(work, list(looks.values()), workers))


def most(trial: Array, before: Array) -> float:
    """What most fabrics have left of square distances: the (upper) median of the ratios."""
    known = np.isfinite(before)
    return float(np.quantile(trial[known] / before[known], 0.5, method="higher")) if known.any() else math.inf


def _come_on(look: FreshLook, capture: CaptureResult, effects: Sequence[Sized]) -> tuple[KeyedDrape, SimulationScene]:
    return look.drape(capture, effects[:-1]), look.seen(capture, effects)


def _squares(look: FreshLook, starts: Sequence[Start], scene: str) -> Array:
    capture = first_capture(look, scene)
    if capture is None:
        return np.full(len(starts), math.inf)
    fabric, depth = look.result.task.parameters, look.task_of(capture).depth
    found = []
    for start in starts:
        state, changed = start(look, capture)
        reached = look.simulator.proceed(state, fabric, changed)
        found.append(state_distance(depth, reached.drape, changed) ** 2 if reached.drape.ok else math.inf)
    return np.array(found)


def _known_square(look: FreshLook, effects: Sequence[Sized], scene: str) -> float:
    capture = first_capture(look, scene)
    if capture is None:
        return math.inf
    return look.distance(capture, effects) ** 2 if look.drape(capture, effects).drape.ok else math.inf


def first_capture(look: FreshLook, scene: str) -> CaptureResult | None:
    """A fabric's first of a scene; None where it has none."""
    return next((c for c in look.result.captures if c.scene == scene), None)
