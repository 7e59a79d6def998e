"""The simulator that a sweep runs: the baseline, or the baseline with the effects that a diagnosis found in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from diagnosis.effects import get_effect
from diagnosis.extension import AppliedEffect, SimulatorExtension
from diagnosis.scene import SimulationScene
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth import panel_depth
from renderer.sensor import named_sensor
from simcore.errors import InputError
from simcore.scenes import Setup

if TYPE_CHECKING:
    from services.dataset.configuration import SweepConfiguration

EFFECT_STREAM = 2
"""Key of the effects' random numbers among those of a simulation."""

MOST_PANEL_SHIFT_M = 1e-3
"""Pictures of a store are read against the panel where it should be; what stands 2 mm off it is taken for cloth."""


def build_scene(configuration: SweepConfiguration, scene: str, seed: int) -> SimulationScene:
    """Set-up, mechanics, camera and sensor of one simulation of a sweep.

    An effect that differs from repeat to repeat is drawn anew from the simulation's seed.

    Raises:
        InputError: an effect has no physical meaning at its size.
    """
    built = SimulationScene(Setup.nominal(scene), sensor=named_sensor(configuration.sensor))
    effects = _of_simulation(configuration.simulator, seed)
    return SimulatorExtension(effects=effects, pin_radius_m=configuration.pin_radius_m).apply(built)


def _of_simulation(effects: Sequence[AppliedEffect], seed: int) -> tuple[AppliedEffect, ...]:
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(EFFECT_STREAM,)))
    return tuple(
        effect.model_copy(update={"size": {**effect.size, "seed": float(rng.integers(1000, 1_000_000))}})
        if get_effect(effect.name).random_repeats
        else effect
        for effect in effects
    )


def check_effects(configuration: SweepConfiguration) -> None:
    """Find out before anything starts whether a sweep can be made with its effects.

    Raises:
        InputError: an effect has no physical meaning at its size, or moves the panel in the picture.
    """
    for name in configuration.scenes:
        plain = build_scene(configuration.model_copy(update={"simulator": ()}), name, 0)
        for effect in configuration.simulator:
            shift = panel_shift_m(SimulatorExtension(effects=(effect,)).apply(plain))
            if not shift <= MOST_PANEL_SHIFT_M:
                raise InputError(
                    f"{effect.name} puts the panel {1e3 * shift:.0f} mm off its place in the pictures, and a store is "
                    "read against its place: correct camera_from_panel or the depth of the captures instead, and take "
                    "the effect out of the simulator file",
                    code="simulator_moves_panel",
                )
        build_scene(configuration, name, 0)


def panel_shift_m(scene: SimulationScene) -> float:
    """How far the panel is, at most, from where a store's pictures are taken to show it [m]."""
    seen = panel_depth(scene.camera, scene.camera_from_panel) * (1.0 + scene.sensor.depth_scale)
    stands = panel_depth(CANONICAL_CAMERA, frontal_pose())
    return float(np.abs(seen + scene.sensor.depth_bias_m - stands).max())
