"""Outcomes of fresh simulations: captures in the folds that come nearest, responses bent through what was simulated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.fresh import (
    FreshLook,
    Sized,
    is_mechanical,
    moves_camera,
    with_effects,
)
from diagnosis.effect import Effect
from diagnosis.effects import get_effect
from diagnosis.measurement.features import measure
from diagnosis.measurement.nearness import nearer
from diagnosis.measurement.picture import state_distance
from diagnosis.simulation.base_state import nearest_state
from diagnosis.simulation.pose_error import pose_responses
from diagnosis.simulation.responses import Responses
from diagnosis.simulation.simulator import KeyedDrape
from diagnosis.simulation.sizes import node_values, node_weights, vector_step
from diagnosis.simulation.state_library import StateLibrary
from diagnosis.tasks.fabric_task import CaptureResult, FabricResult, see_state

Array = NDArray[np.float64]
SLACK = 0.02
"""Outcomes at several sizes are met but for this relative variance: sizes near each other may show other folds."""
SLACK_OF_PICTURES = 0.002
"""The same where only the camera moves: the folds are those of one state."""
ASIDE = 0.5
"""Share of the size at which a vector's components are simulated: one below half of it is seen there instead."""


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
    depth = look.task_of(capture).depth
    best, near = capture.base, nearer(capture.rms_m, scene)
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
    depth = look.task_of(capture).depth
    for camera in cameras:
        changed = with_effects(scene, [camera])
        near = min(capture.rms_m, state_distance(depth, capture.base.drape, changed))
        found, reached = nearest_state(look.simulator, task.parameters, changed, depth, [capture.base])
        if found.drape.ok and reached < nearer(near, changed):
            capture = at_state(look, capture, found, reached)
        else:
            capture = replace(capture, rms_m=near)
    return capture


def at_state(look: FreshLook, capture: CaptureResult, state: KeyedDrape, near: float) -> CaptureResult:
    """A capture measured from another state, which is so near to it [m]."""
    shown = look.task_of(capture)
    scene = shown.scene
    seen = see_state(look.simulator, look.result.task, scene, state)
    look.coarse[capture.id] = seen.responses
    look.beside.pop(capture.id, None)  # measured from another state
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
