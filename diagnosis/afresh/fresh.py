"""Effects simulated afresh at their fitted sizes, from the fold states that were found, on the fine mesh.

The responses of :mod:`diagnosis.simulation.responses` are taken on a coarse mesh at a few sizes. For what is about to
be named that is not good enough: here the very size is simulated, and the table of responses is bent through the
outcome.
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
from diagnosis.measurement.picture import noise_square, picture_of, state_distance
from diagnosis.scene import SimulationScene
from diagnosis.simulation.base_state import nearest_state
from diagnosis.simulation.drape_cache import drape_key
from diagnosis.simulation.pose_error import pose_responses
from diagnosis.simulation.responses import Responses
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from diagnosis.simulation.sizes import node_values, node_weights, vector_step
from diagnosis.simulation.state_library import StateLibrary
from diagnosis.simulation.variations import clean
from diagnosis.tasks.fabric_task import (
    AS_NEAR_AS_BEFORE,
    AS_NEAR_M,
    BASE_JITTER,
    CaptureResult,
    FabricResult,
    see_state,
)
from simcore.parameters import FabricParameters

Array = NDArray[np.float64]
NEAR_ENOUGH_M = 0.0006
"""A state whose difference from the capture is noise but for this needs no further search."""
NEARER, NEAR_MARGIN_M = 0.95, 0.0001
"""A state is taken instead of the one that was found first where it is so much nearer to the capture."""
WORSE_M = 0.0002
"""An effect with which a capture is further away by more than this may be simulated in the wrong folds."""
SLACK = 0.02
"""Outcomes at several sizes are met but for this relative variance: sizes near each other may show other folds."""
SLACK_OF_PICTURES = 0.002
"""The same where only the camera moves: the folds are those of one state."""
ASIDE = 0.5
"""Share of the size at which a vector's components are simulated: one below half of it is seen there instead."""
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

    def scene_of(self, capture: CaptureResult) -> SimulationScene:
        """The simulation that should give a capture, without effects."""
        return next(c.scene for c in self.result.task.captures if c.id == capture.id)

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
            best = self._nearest(capture, changed, [name for name, _ in effects])
        if fabric is None or fabric == self.result.task.parameters:
            return best
        return self.simulator.proceed(best, fabric, changed)

    def distance(self, capture: CaptureResult, effects: Sequence[Sized]) -> float:
        """Of a capture from that drape, through the camera that fits [m]."""
        depth = next(c.depth for c in self.result.task.captures if c.id == capture.id)
        return state_distance(depth, self.drape(capture, effects).drape, self.seen(capture, effects))

    def _nearest(self, capture: CaptureResult, changed: SimulationScene, names: Sequence[str]) -> KeyedDrape:
        """The search begins at states of the same effects at another size, else of all but the last, else of none."""
        fabric = self.result.task.parameters
        depth = next(c.depth for c in self.result.task.captures if c.id == capture.id)
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
        enough = max(math.sqrt(noise_square(changed) + NEAR_ENOUGH_M**2), AS_NEAR_AS_BEFORE * reached + AS_NEAR_M)
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
                least = NEARER * near - NEAR_MARGIN_M
                if start.drape.ok and so_near < least:
                    led = self.simulator.proceed(start, self.result.task.parameters, changed)
                    if (left := self._take(capture, changed, led, least)) < near:
                        drape, near = led, left
            _, begun = self.begun.get((capture.id, name), (drape, math.inf))
            if near < NEARER * begun - NEAR_MARGIN_M:
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
        depth = next(c.depth for c in self.result.task.captures if c.id == capture.id)
        near = state_distance(depth, found.drape, scene)
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
        return self._take(capture, scene, left, NEARER * near - NEAR_MARGIN_M) < math.inf

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
        candidates: effects on cloth or camera with their sizes.
        scene: captures of this scene are looked at again; those of another one only where nothing must be solved.
    """
    for name, size in candidates:
        look.sizes.setdefault(name, []).append(size)
    solved = [(name, size) for name, size in candidates if get_effect(name).moves_cloth]
    cameras = [(name, size) for name, size in candidates if moves_camera(name)]
    captures = []
    for capture in look.result.captures:
        capture = _seen_through(look, capture, cameras)
        if capture.scene == scene:
            capture = in_nearest_folds(look, capture, solved)
        names = [n for n in look.sizes if capture.scene == scene or not get_effect(n).moves_cloth]
        captures.append(replace(capture, responses=bent(look, capture, names)))
    return replace(look.result, captures=tuple(captures))


def in_nearest_folds(look: FreshLook, capture: CaptureResult, candidates: Sequence[Sized]) -> CaptureResult:
    """A capture with all that is simulated of it, with some effects and without any, in the folds that come nearest.

    Args:
        look: of the fabric; it learns.
        capture: to look at.
        candidates: effects on the cloth that are new, with their sizes, which ``look.sizes`` has, too.
    """
    for name in dict(candidates):
        look.agree(capture, name)
    found = _rebased(look, capture, candidates)
    if found.base is not capture.base:  # what was known of other effects was seen from another state
        for name in look.sizes:
            if is_mechanical(get_effect(name)):
                look.agree(found, name)
    return found


def _rebased(look: FreshLook, capture: CaptureResult, candidates: Sequence[Sized]) -> CaptureResult:
    """From the state without effects that is nearest, those that effects leave behind when they are gone included.

    An effect may only help the cloth over a ridge into folds that the capture shows and the first search missed.
    """
    task, scene = look.result.task, look.seen(capture)
    depth = next(c.depth for c in task.captures if c.id == capture.id)
    best, near = capture.base, NEARER * capture.rms_m - NEAR_MARGIN_M
    for candidate in candidates:
        shown = look.drape(capture, [candidate])
        left = look.simulator.proceed(shown, task.parameters, scene) if shown.drape.ok else shown
        if left.drape.ok and state_distance(depth, left.drape, scene) < near:
            best, near = left, state_distance(depth, left.drape, scene)
    if best is capture.base:
        return capture
    StateLibrary.of(look.simulator.cache, best.drape.mesh, task.parameters, scene).add(best)
    return at_state(look, capture, best, near)


def _seen_through(look: FreshLook, capture: CaptureResult, cameras: Sequence[Sized]) -> CaptureResult:
    """From the state that is nearest through a camera that stands where an effect on it says, if it is nearer so.

    Through the stated camera a capture may look like other folds than it shows. Its distance is then measured through
    the camera that fits.
    """
    task, scene = look.result.task, look.scene_of(capture)
    depth = next(c.depth for c in task.captures if c.id == capture.id)
    for camera in cameras:
        changed = with_effects(scene, [camera])
        near = min(capture.rms_m, state_distance(depth, capture.base.drape, changed))
        found, reached = nearest_state(look.simulator, task.parameters, changed, depth, [capture.base])
        if found.drape.ok and reached < NEARER * near - NEAR_MARGIN_M:
            capture = at_state(look, capture, found, reached)
        else:
            capture = replace(capture, rms_m=near)
    return capture


def at_state(look: FreshLook, capture: CaptureResult, state: KeyedDrape, near: float) -> CaptureResult:
    """A capture measured from another state, which is so near to it [m]."""
    task, scene = look.result.task, look.scene_of(capture)
    shown = next(c for c in task.captures if c.id == capture.id)
    seen = see_state(look.simulator, task, scene, state)
    look.coarse[capture.id] = seen.responses
    return replace(
        capture,
        base=state,
        reference=seen.reference,
        responses=seen.responses,
        warps=seen.warps,
        measured=measure(shown.depth, seen.reference),
        rms_m=near,
        pose=pose_responses(state.drape, scene, seen.reference, shown.pose_error_m),
    )


def bent(look: FreshLook, capture: CaptureResult, names: Sequence[str]) -> Responses:
    """Through the outcomes of some effects at all sizes that were simulated so far; of a moved camera at the last.

    What was measured beside others, and by probes, from the same state stays.
    """
    coarse = look.coarse.setdefault(capture.id, capture.responses)
    effects = dict(coarse.effects)
    for name in names:
        effect = get_effect(name)
        seen_by_itself = effect.vector and not effect.moves_cloth  # rendered alone: nothing to solve
        sizes = around(effect, look.sizes[name][-1]) if seen_by_itself else look.sizes[name]
        solved = [size for size in sizes if look.drape(capture, [(name, size)]).drape.ok]
        known = [(size, look.change(capture, [(name, size)])) for size in solved]
        if known:
            rows, pixels = effects[name]
            effects[name] = (bend(effect, rows, known), pixels)
    return replace(coarse, effects=effects, beside=capture.responses.beside, probes=capture.responses.probes)


def around(effect: Effect, size: Mapping[str, float]) -> list[Mapping[str, float]]:
    """A vector's size, and those without one of its components; a small one is made larger instead.

    What all components do together does not tell what each does: put down to them by their lengths, what one of them
    changes otherwise than it should looks like another one.
    """
    aside = ASIDE * vector_step(effect)

    def changed(value: float) -> float:
        return 0.0 if abs(value) > 0.5 * aside else math.copysign(aside, value)

    return [size, *(dict(size) | {name: changed(size[name])} for name in effect.components)]


def bend(effect: Effect, rows: Array, known: Sequence[tuple[Mapping[str, float], Array]]) -> Array:
    """Responses at an effect's nodes, changed as little as possible so that they give what is known at some sizes.

    Args:
        effect: whose.
        rows: at its nodes, [nodes, D].
        known: sizes with the outcome there, [D]; one is met exactly, several but for :data:`SLACK`, or
            :data:`SLACK_OF_PICTURES`.

    Where an effect does much alike at its places, what is learnt at one holds at the others as well, nearly.
    """
    weights = np.stack([node_weights(effect, size) for size, _ in known])
    missing = np.stack([wanted for _, wanted in known]) - weights @ rows
    relative = SLACK if effect.moves_cloth else SLACK_OF_PICTURES
    slack = relative * np.eye(len(known)) if len(known) > 1 else np.zeros((1, 1))
    reached = weights @ _covariance(effect)
    return np.asarray(rows + reached.T @ np.linalg.solve(reached @ weights.T + slack, missing))


def _covariance(effect: Effect) -> Array:
    """Of what is not known about the responses at an effect's nodes, [nodes, nodes], its diagonal one."""
    places = len(effect.tried)
    alike = (1.0 - effect.alike) * np.eye(places) + effect.alike
    count = 2 * len(effect.components) if effect.vector else len(node_values(effect))
    return np.asarray(np.kron(alike, np.eye(count)))
