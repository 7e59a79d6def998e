"""Seed of an effect that is another one in every repeat, alike for a sweep's simulation and for one done by hand."""

from __future__ import annotations

import numpy as np

from services.random_streams import EFFECT_STREAM
from simcore.parameters import FabricParameters


def draw_effect_seed(effect: str, scene: str, cloth: FabricParameters, seed: int) -> float:
    """The same for the same seed, effect, scene and fabric, another one otherwise.

    Args:
        effect: its name.
        scene: name of the scene.
        cloth: the fabric.
        seed: of the simulation.

    Returns:
        A whole number from 1000 to 999,999.
    """
    told = "\n".join([effect, scene, *(value.hex() for value in cloth.as_dict().values())]).encode()
    words = np.random.SeedSequence([seed, *told], spawn_key=(EFFECT_STREAM,))
    return float(np.random.default_rng(words).integers(1000, 1_000_000))
