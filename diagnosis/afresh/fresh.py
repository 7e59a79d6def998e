"""Effects simulated afresh at their fitted sizes, from the fold states that were found, on the fine mesh.

The responses of :mod:`diagnosis.simulation.responses` are taken on a coarse mesh at a few sizes. For what is about to
be named that is not good enough: here the very size is simulated (:mod:`diagnosis.afresh.outcomes` bends the table of
responses through what comes out).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import Effect, Stage
from diagnosis.effects import get_effect
from diagnosis.measurement.features import measure
from diagnosis.measurement.nearness import nearer, no_further
from diagnosis.measurement.picture import noise_square, picture_of, state_distance
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import drape_key
from diagnosis.simulation.responses import Responses
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from diagnosis.simulation.variations import clean
from diagnosis.tasks.fabric_task import (
    BASE_JITTER,
    CaptureResult,
    CaptureTask,
    FabricResult,
)
from simcore.parameters import FabricParameters

Array = NDArray[np.float64]
NEAR_ENOUGH_M = 0.0006
"""A state whose difference from the capture is noise but for this needs no further search."""
WORSE_M = 0.0002
"""An effect with which a capture is further away by more than this may be simulated in the wrong folds."""
Sized = tuple[str, Mapping[str, float]]
"""Name of an effect and its size."""


def is_mechanical(effect: Effect) -> bool:
    """It changes how the cloth comes to rest, the same way in all repeats, and does not hold it wherever it was put.

    Effects that hold it are not looked at again, and nothing is led with them on.
    """
    return effect.moves_cloth and not effect.holds


def moves_camera(name: str) -> bool:
    """The effect says that the camera stands elsewhere than stated."""
    return get_effect(name).stage is Stage.CAMERA


def changes_pictures(name: str) -> bool:
    """The effect is on camera or sensor."""
    return get_effect(name).stage in (Stage.CAMERA, Stage.SENSOR)


@dataclass
class FreshLook:
    """Simulates effects from the states of one fabric's captures.

    Attributes:
        simulator: solves and keeps.
        result: the fabric's captures with the states that they show.
        found: states with effects on and their distance from a capture [m], by what was simulated and by capture.
        begun: the first state that was found with some effects on, and its distance, by capture and names.
        sizes: at which an effect's outcome is known, by its name.
        coarse: responses as they were before any outcome bent them, by capture.
        beside: what effects change where another one is on, by capture and (effect, other), before any outcome of both.
        together: sizes of one effect and another at which both were simulated, by (effect, other).
        through: effects on the camera through which captures are held against simulations; none: as it is stated.
    """

    simulator: Simulator
    result: FabricResult
    found: dict[str, dict[str, tuple[KeyedDrape, float]]] = field(default_factory=dict)
    begun: dict[tuple[str, str], tuple[KeyedDrape, float]] = field(default_factory=dict)
    sizes: dict[str, list[Mapping[str, float]]] = field(default_factory=dict)
    coarse: dict[str, Responses] = field(default_factory=dict)
    beside: dict[str, dict[tuple[str, str], tuple[Array, Array]]] = field(default_factory=dict)
    together: dict[tuple[str, str], list[list[Sized]]] = field(default_factory=dict)
    through: tuple[Sized, ...] = ()

    def copy(self) -> FreshLook:
        """One that may learn more without this one knowing."""
        return replace(
            self,
            found={key: dict(known) for key, known in self.found.items()},
            begun=dict(self.begun),
            sizes={name: list(sizes) for name, sizes in self.sizes.items()},
            coarse=dict(self.coarse),
            beside={key: dict(rows) for key, rows in self.beside.items()},
            together={names: list(sizes) for names, sizes in self.together.items()},
        )

    def task_of(self, capture: CaptureResult) -> CaptureTask:
        """What there is to explain: a capture's picture and the simulation that should give it."""
        return next(c for c in self.result.task.captures if c.id == capture.id)

    def scene_of(self, capture: CaptureResult) -> SimulationScene:
        """The simulation that should give a capture, without effects."""
        return self.task_of(capture).scene

    def seen(self, capture: CaptureResult, effects: Sequence[Sized] = ()) -> SimulationScene:
        """That with effects on, through the camera that fits where none of them says how it stands."""
        stated = not any(moves_camera(name) for name, _ in effects)
        return with_effects(self.scene_of(capture), [*effects, *(self.through if stated else ())])

    def drape(
        self, capture: CaptureResult, effects: Sequence[Sized], fabric: FabricParameters | None = None
    ) -> KeyedDrape:
        """The equilibrium with effects on that is nearest to a capture, and perhaps with other parameters.

        What the capture's state turns into when the effects come on is often another fold state than the one in which
        a sample comes to rest that was put up with them: where it does not fit, the capture's heights lead the way,
        and where it fits worse than without the effects, a sample is put up with them.
        """
        scene = self.scene_of(capture)
        changed = self.seen(capture, effects)
        best = capture.base
        if (changed.setup, changed.mechanics) != (scene.setup, scene.mechanics):
            best = self._nearest(capture, changed, [name for name, _ in effects if get_effect(name).moves_cloth])
        if fabric is None or fabric == self.result.task.parameters or not is_finite(best):
            return best
        return self.simulator.proceed(best, fabric, changed)

    def distance(self, capture: CaptureResult, effects: Sequence[Sized]) -> float:
        """Of a capture from that drape, through the camera that fits [m]; infinite where it diverged."""
        found = self.drape(capture, effects)
        if not is_finite(found):
            return math.inf
        return state_distance(self.task_of(capture).depth, found.drape, self.seen(capture, effects))

    def _nearest(self, capture: CaptureResult, changed: SimulationScene, names: Sequence[str]) -> KeyedDrape:
        """The search begins at states of the same effects at another size, else of all but the last, else of none."""
        fabric, depth = self.result.task.parameters, self.task_of(capture).depth
        known = self.found.setdefault(self._key(capture, changed), {})
        if capture.id in known:
            return known[capture.id][0]

        def distance(drape: KeyedDrape) -> float:
            return state_distance(depth, drape.drape, changed) if drape.drape.ok else math.inf

        all_on, all_but_one = ((capture.id, " ".join(on)) for on in (names, names[:-1]))
        begun, _ = self.begun.get(all_but_one, (capture.base, 0.0))
        begun, reached = self.begun.get(all_on, (begun, 0.0))
        first = self.simulator.proceed(begun, fabric, changed)
        best = min([first, *(drape for drape, _ in known.values())], key=distance)
        near = distance(best)
        reached = min((d for drape, d in known.values() if drape.key == best.key), default=reached)
        enough = max(math.sqrt(noise_square(changed) + NEAR_ENOUGH_M**2), no_further(reached, changed))
        if near > enough and changed.mechanics.friction == 0.0:
            others = [self.simulator.led(capture.base, fabric, changed, depth)]
            if min(near, distance(others[0])) > capture.rms_m + WORSE_M:
                others.append(self.simulator.put_up(best.drape.mesh, fabric, changed, 0, BASE_JITTER))
            best = min([best, *others], key=distance)
            near = distance(best)
        known[capture.id] = (best, near)
        if best.drape.ok:
            self.begun.setdefault(all_on, (best, near))
        return best

    def agree(self, capture: CaptureResult, name: str) -> None:
        """Let an effect be known, at all its sizes, from the nearest folds that a capture was ever seen in.

        A search that finds them at one size, or only without the effect, and misses them at the next would have
        responses pass through both. Later sizes begin where it is nearest, too.
        """
        known = [(size, *self._known(capture, [(name, size)])) for size in self.sizes[name]]
        _, best, reached = min(known, key=lambda one: one[2])
        starts = [(best, reached), (capture.base, capture.rms_m)]
        for size, drape, near in known:
            changed = self.seen(capture, [(name, size)])
            for start, so_near in starts:
                least = nearer(near, changed)
                if start.drape.ok and so_near < least:
                    led = self.simulator.proceed(start, self.result.task.parameters, changed)
                    if (left := self._take(capture, changed, led, least)) < near:
                        drape, near = led, left
            _, begun = self.begun.get((capture.id, name), (drape, math.inf))
            if near < nearer(begun, self.scene_of(capture)):
                self.begun[capture.id, name] = (drape, near)

    def _known(self, capture: CaptureResult, effects: Sequence[Sized]) -> tuple[KeyedDrape, float]:
        """The drape with effects on, and its distance from a capture [m]; infinite where it is not at rest."""
        drape = self.drape(capture, effects)
        return drape, self.distance(capture, effects) if drape.drape.ok else math.inf

    def _key(self, capture: CaptureResult, scene: SimulationScene) -> str:
        return drape_key(capture.base.drape.mesh, self.result.task.parameters, scene.setup, scene.mechanics)

    def _take(self, capture: CaptureResult, scene: SimulationScene, found: KeyedDrape, least: float) -> float:
        """Know a scene by this drape from now on where it is nearer to a capture than ``least`` [m].

        Returns:
            How near it then is [m]; infinity where it is not taken.
        """
        if not found.drape.ok:
            return math.inf
        near = state_distance(self.task_of(capture).depth, found.drape, scene)
        if near >= least:
            return math.inf
        self.found.setdefault(self._key(capture, scene), {})[capture.id] = (found, near)
        return near

    def without_last(self, capture: CaptureResult, effects: Sequence[Sized]) -> bool:
        """Let the last of some effects go again; whether that leaves the cloth nearer to a capture than it was known.

        It may only have helped the cloth over a ridge into folds that the search with the others missed.
        """
        scene = self.seen(capture, effects[:-1])
        shown, (_, near) = self.drape(capture, effects), self._known(capture, effects[:-1])
        if not shown.drape.ok:
            return False
        left = self.simulator.proceed(shown, self.result.task.parameters, scene)
        return self._take(capture, scene, left, nearer(near, scene)) < math.inf

    def picture(
        self, capture: CaptureResult, effects: Sequence[Sized], fabric: FabricParameters | None = None
    ) -> NDArray[np.float32]:
        """Ideal picture of that drape through the camera with effects on [m], [H, W]; of the state without them where
        it diverged.
        """
        found = self.drape(capture, effects, fabric)
        shown = found if is_finite(found) else capture.base
        return picture_of(shown.drape, with_effects(self.scene_of(capture), effects))

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


def is_finite(found: KeyedDrape) -> bool:
    """It did not diverge."""
    return found.drape.ok or bool(np.isfinite(found.drape.vertices).all())


def with_effects(scene: SimulationScene, effects: Sequence[Sized]) -> SimulationScene:
    """A scene with effects on; those that differ from repeat to repeat are left out."""
    for name, size in effects:
        if not get_effect(name).random_repeats:
            scene = get_effect(name).apply(scene, size)
    return scene
