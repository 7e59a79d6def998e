"""Where an effect truly is, which may be anywhere, against where the diagnosis looks for it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from diagnosis.effect import Effect
from diagnosis.effects import get_effect


def at_a_tried_place(name: str, size: Mapping[str, float]) -> dict[str, float]:
    """A size at the nearest place where the diagnosis looks for the effect, of which responses are known."""
    effect = get_effect(name)
    return {**size, **effect.tried[_nearest(effect, size)]}


def is_its_place(name: str, truth: Mapping[str, float], found: Mapping[str, float]) -> bool:
    """Whether an effect was found at the tried place nearest to its own, or less than one step of these away."""
    effect = get_effect(name)
    if effect.number_of(found) == _nearest(effect, truth):
        return True
    for key in effect.tried[0]:
        steps = np.diff(np.unique([place[key] for place in effect.tried]))
        if len(steps) and abs(found[key] - truth[key]) >= steps.min():
            return False
    return True


def _nearest(effect: Effect, size: Mapping[str, float]) -> int:
    keys = list(effect.tried[0])
    places = np.array([[place[key] for key in keys] for place in effect.tried])
    spread = np.maximum(np.ptp(places, axis=0), 1e-9)
    away = np.abs(places - np.array([size[key] for key in keys])) / spread
    return int(np.argmin(away.sum(axis=1)))
