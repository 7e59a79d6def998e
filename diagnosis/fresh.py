"""Effects simulated afresh at their fitted sizes, from the fold states that were found, on the fine mesh.

The responses of :mod:`diagnosis.responses` are taken on a coarse mesh at a few sizes. For what is about to be named
that is not good enough: here the very size is simulated, and the table of responses is bent through the outcome.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.base_state import picture_of
from diagnosis.effect import Effect, Stage
from diagnosis.effects import get_effect
from diagnosis.fabric_task import CaptureResult, FabricResult
from diagnosis.features import measure
from diagnosis.responses import Responses, clean
from diagnosis.scene import SimulationScene
from diagnosis.simulator import KeyedDrape, Simulator
from diagnosis.sizes import node_weights
from simcore.parameters import FabricParameters

Array = NDArray[np.float64]
Sized = tuple[str, Mapping[str, float]]
"""Name of an effect and its size."""


def is_mechanical(effect: Effect) -> bool:
    """It changes how the cloth comes to rest, the same way in all repeats."""
    return effect.stage in (Stage.FABRIC, Stage.SETUP, Stage.ENVIRONMENT) and not effect.random_repeats


@dataclass
class FreshLook:
    """Simulates effects from the states of one fabric's captures.

    Attributes:
        simulator: solves and keeps.
        result: the fabric's captures with the states that they show.
    """

    simulator: Simulator
    result: FabricResult

    def scene_of(self, capture: CaptureResult) -> SimulationScene:
        """The simulation that should give a capture, without effects."""
        return next(c.scene for c in self.result.task.captures if c.id == capture.id)

    def drape(
        self, capture: CaptureResult, effects: Sequence[Sized], fabric: FabricParameters | None = None
    ) -> KeyedDrape:
        """What a capture's state turns into with effects on, and perhaps other parameters."""
        scene = self.scene_of(capture)
        changed = with_effects(scene, effects)
        own = fabric or self.result.task.parameters
        same = own == self.result.task.parameters
        if same and (changed.setup, changed.mechanics) == (scene.setup, scene.mechanics):
            return capture.base
        return self.simulator.proceed(capture.base, own, changed)

    def picture(
        self, capture: CaptureResult, effects: Sequence[Sized], fabric: FabricParameters | None = None
    ) -> NDArray[np.float32]:
        """Ideal picture of that drape through the camera with effects on [m], [H, W]."""
        return picture_of(self.drape(capture, effects, fabric).drape, with_effects(self.scene_of(capture), effects))

    def change(self, capture: CaptureResult, effects: Sequence[Sized]) -> Array:
        """Change of a capture's shape-and-plane vector by effects, [cells + ring + 3]."""
        scene = self.scene_of(capture)
        changed = with_effects(scene, effects)
        picture = self.picture(capture, effects)
        if changed.sensor == scene.sensor:
            return clean(measure(picture, capture.reference, with_pixels=False).vector())
        pictures = ((changed, picture), (scene, capture.reference.depth))
        seen = [s.sensor.apply(p, np.random.default_rng(0), camera=s.camera) for s, p in pictures]
        after, before = (measure(p, capture.reference, with_pixels=False).vector() for p in seen)
        return clean(after - before)


def with_effects(scene: SimulationScene, effects: Sequence[Sized]) -> SimulationScene:
    """A scene with effects on; those that differ from repeat to repeat are left out."""
    for name, size in effects:
        if not get_effect(name).random_repeats:
            scene = get_effect(name).apply(scene, size)
    return scene


def freshen(look: FreshLook, candidates: Sequence[Sized], scene: str) -> FabricResult:
    """The same fabric with responses that pass through fresh simulations of some effects at some sizes.

    Args:
        look: of the fabric.
        candidates: mechanical effects with their sizes.
        scene: captures of this scene are looked at again.
    """
    done: dict[str, Responses] = {}
    captures = []
    for capture in look.result.captures:
        if capture.scene == scene:
            key = f"{capture.base.key} {look.scene_of(capture)}"
            if key not in done:
                done[key] = _bent(look, capture, candidates)
            capture = replace(capture, responses=done[key])
        captures.append(capture)
    return replace(look.result, captures=tuple(captures))


def _bent(look: FreshLook, capture: CaptureResult, candidates: Sequence[Sized]) -> Responses:
    effects = dict(capture.responses.effects)
    for name, size in candidates:
        drape = look.drape(capture, [(name, size)])
        if drape.drape.ok:
            rows, pixels = effects[name]
            effects[name] = (bend(get_effect(name), rows, size, look.change(capture, [(name, size)])), pixels)
    return replace(capture.responses, effects=effects)


def bend(effect: Effect, rows: Array, size: Mapping[str, float], wanted: Array) -> Array:
    """Responses at an effect's nodes, changed as little as possible so that they give ``wanted`` at a size.

    Args:
        effect: whose.
        rows: at its nodes, [nodes, D].
        size: where the outcome is known.
        wanted: the outcome, [D].
    """
    weights = node_weights(effect, size)
    missing = wanted - weights @ rows
    return np.asarray(rows + np.outer(weights / float(weights @ weights), missing))
