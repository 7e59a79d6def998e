"""Where an effect truly is, which may be anywhere, against where the diagnosis looks for it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from diagnosis.afresh.between import further_places
from diagnosis.effect import Effect
from diagnosis.effects import get_effect


def at_a_tried_place(name: str, size: Mapping[str, float]) -> dict[str, float]:
    """A size at the nearest place where the diagnosis looks for the effect, of which responses are known."""
    effect = get_effect(name)
    return {**size, **effect.tried[_nearest(effect, size)]}


def is_its_place(name: str, truth: Mapping[str, float], found: Mapping[str, float]) -> bool:
    """Whether an effect was found at the tried place that is nearest to its own, or at one beside that."""
    effect = get_effect(name)
    nearest = _nearest(effect, truth)
    return effect.number_of(found) in (nearest, *further_places(effect, effect.tried[nearest]))


def _nearest(effect: Effect, size: Mapping[str, float]) -> int:
    keys = list(effect.tried[0])
    places = np.array([[place[key] for key in keys] for place in effect.tried])
    spread = np.maximum(np.ptp(places, axis=0), 1e-9)
    away = np.abs(places - np.array([size[key] for key in keys])) / spread
    return int(np.argmin(away.sum(axis=1)))
