"""The simulator that a sweep runs: the baseline, or the baseline with the effects that a diagnosis found in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from diagnosis.effects import get_effect
from diagnosis.extension import AppliedEffect, SimulatorExtension
from diagnosis.scene import SimulationScene
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth import panel_depth
from renderer.sensor import named_sensor
from renderer.store_format import DEPTH_UNIT_M
from services.effect_seed import draw_effect_seed
from services.seen_panel import shows_panel
from simcore.checks import check_request
from simcore.errors import InputError
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

if TYPE_CHECKING:
    from services.dataset.configuration import SweepConfiguration

SOME_CLOTH = FabricParameters(1000.0, 1000.0, 300.0, 1e-5, 1e-5, 1e-5, 0.2)
"""Any fabric: what is checked beforehand does not hang on it."""

MOST_PANEL_SHIFT_M = 1e-3
"""Pictures of a store are read against the panel where it should be; what stands 2 mm off it is taken for cloth."""


def build_scene(configuration: SweepConfiguration, scene: str, cloth: FabricParameters, seed: int) -> SimulationScene:
    """Set-up, mechanics, camera and sensor of one simulation of a sweep.

    An effect that differs from repeat to repeat is drawn anew from the simulation's seed, as `drapemeter simulate` does
    it.

    Raises:
        InputError: an effect has no physical meaning at its size.
    """
    built = SimulationScene(Setup.nominal(scene), sensor=named_sensor(configuration.sensor))
    extension = SimulatorExtension(effects=tuple(configuration.simulator), pin_radius_m=configuration.pin_radius_m)
    return extension.seeded(lambda effect: draw_effect_seed(effect, scene, cloth, seed)).apply(built)


def check_effects(configuration: SweepConfiguration) -> None:
    """Find out before anything starts whether a sweep can be made with its effects.

    Raises:
        InputError: an effect is named twice or without a size, has no physical meaning at its size, puts pins where
            the cloth does not reach, moves the panel in the picture, or leaves no picture that a store can hold.
    """
    _check_sizes(configuration)
    for name in configuration.scenes:
        plain = build_scene(configuration.model_copy(update={"simulator": ()}), name, SOME_CLOTH, 0)
        for effect in configuration.simulator:
            shift = panel_shift_m(SimulatorExtension(effects=(effect,)).apply(plain))
            if moves_panel(effect, plain):
                raise InputError(
                    f"{effect.name} puts the panel {1e3 * shift:.0f} mm off its place in the pictures, and a store is "
                    "read against its place: correct camera_from_panel or the depth of the captures instead, and take "
                    "the effect out of the simulator file",
                    code="simulator_moves_panel",
                )
        built = build_scene(configuration, name, SOME_CLOTH, 0)
        check_request(configuration.mesh, built.setup, None, configuration.time_limit_s)
        _check_sensor(built)


def _check_sizes(configuration: SweepConfiguration) -> None:
    names = [effect.name for effect in configuration.simulator]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(f"effect {twice[0]} is given twice: give it once", code="effect_twice")
    for effect in configuration.simulator:
        if not effect.size:
            known = ", ".join(get_effect(effect.name).components)
            raise InputError(f"effect {effect.name} has no size: give its {known}", code="effect_magnitude")


def _check_sensor(scene: SimulationScene) -> None:
    """Whether a picture of the panel alone comes through the sensor into a store."""
    if not shows_panel(scene, DEPTH_UNIT_M):
        raise InputError(
            "with the simulator file's effects the sensor reads nothing at all: give them smaller sizes",
            code="simulator_blind",
        )


def moves_panel(effect: AppliedEffect, plain: SimulationScene | None = None) -> bool:
    """An effect puts the panel elsewhere in the pictures of a sweep than a store's reader takes it to be.

    Args:
        effect: of a simulator file.
        plain: scene of the sweep without effects; a nominal one by default.
    """
    scene = SimulationScene(Setup.nominal("stretch")) if plain is None else plain
    return not panel_shift_m(SimulatorExtension(effects=(effect,)).apply(scene)) <= MOST_PANEL_SHIFT_M


def panel_shift_m(scene: SimulationScene) -> float:
    """How far the panel is, at most, from where a store's pictures are taken to show it [m]."""
    seen = panel_depth(scene.camera, scene.camera_from_panel) * (1.0 + scene.sensor.depth_scale)
    stands = panel_depth(CANONICAL_CAMERA, frontal_pose())
    return float(np.abs(seen + scene.sensor.depth_bias_m - stands).max())
