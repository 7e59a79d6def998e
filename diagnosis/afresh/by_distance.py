"""How far captures are from simulations with effects on, for one simulation each: to choose what is sought."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.fresh import FreshLook, Sized
from diagnosis.measurement.picture import state_distance
from diagnosis.scene import SimulationScene
from diagnosis.simulation.simulator import KeyedDrape
from diagnosis.tasks.fabric_task import CaptureResult
from diagnosis.workers import ALONE, Workers

Array = NDArray[np.float64]


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
    work = partial(_squares, trials=trials, scene=scene)
    return np.stack(workers.map(work, list(looks.values())), axis=1)


def known_squares(
    looks: Mapping[str, FreshLook], effects: Sequence[Sized], scene: str, workers: Workers = ALONE
) -> Array:
    """The same from the nearest simulations with effects on, as :meth:`FreshLook.drape` finds them [m²], [fabrics]."""
    return np.array(workers.map(partial(_known_square, effects=effects, scene=scene), list(looks.values())))


def most(trial: Array, before: Array) -> float:
    """What most fabrics have left of square distances: the (upper) median of the ratios."""
    known = np.isfinite(before)
    return float(np.quantile(trial[known] / before[known], 0.5, method="higher")) if known.any() else math.inf


def _squares(look: FreshLook, trials: Sequence[Sequence[Sized]], scene: str) -> Array:
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # it ships no type information

    capture = first_capture(look, scene)
    if capture is None:
        return np.full(len(trials), math.inf)
    with threadpool_limits(1):
        return np.array([square(look, capture, look.drape(capture, on[:-1]), look.seen(capture, on)) for on in trials])


def square(look: FreshLook, capture: CaptureResult, start: KeyedDrape, changed: SimulationScene) -> float:
    """Square distance of a capture from what a state turns into in a changed scene [m²]; infinite where not at rest."""
    task = look.result.task
    depth = next(c.depth for c in task.captures if c.id == capture.id)
    state = look.simulator.proceed(start, task.parameters, changed)
    return state_distance(depth, state.drape, changed) ** 2 if state.drape.ok else math.inf


def _known_square(look: FreshLook, effects: Sequence[Sized], scene: str) -> float:
    from threadpoolctl import threadpool_limits

    capture = first_capture(look, scene)
    if capture is None:
        return math.inf
    with threadpool_limits(1):
        return look.distance(capture, effects) ** 2 if look.drape(capture, effects).drape.ok else math.inf


def first_capture(look: FreshLook, scene: str) -> CaptureResult | None:
    """A fabric's first of a scene."""
    return next((c for c in look.result.captures if c.scene == scene), None)
