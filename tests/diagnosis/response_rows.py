"""Rows of made-up responses: at the sizes that are simulated, and mixed for places between them."""

from __future__ import annotations

import numpy as np

from diagnosis.effects import get_effect
from diagnosis.simulation.sizes import at_all_places, nodes


def random_rows(rng: np.random.Generator, name: str, length: float, numbers: int) -> np.ndarray:
    """Of random form, each number about so long, [nodes of all tried places, numbers]."""
    effect = get_effect(name)
    return at_all_places(effect, length * rng.standard_normal((len(nodes(effect)), numbers)))


def still_rows(name: str, numbers: int = 1) -> np.ndarray:
    """Nothing moves, [nodes of all tried places, numbers]."""
    effect = get_effect(name)
    return at_all_places(effect, np.zeros((len(nodes(effect)), numbers)))
