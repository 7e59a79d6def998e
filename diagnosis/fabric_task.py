"""All simulations that the diagnosis of one fabric needs, in one process."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.base_state import depth_rms, nearest_state, picture_of
from diagnosis.drape_cache import DrapeCache
from diagnosis.effect import Effect, Size, Stage
from diagnosis.effects import get_effect
from diagnosis.features import Features, measure
from diagnosis.reference import Reference, make_reference
from diagnosis.scene import SimulationScene
from diagnosis.simulator import Cost, KeyedDrape, Simulator
from diagnosis.sizes import nodes
from simcore.mechanics import Jitter
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters

BASE_JITTER = Jitter(force_weights=1.0, pin_m=0.0, placement_m=0.02)
BASE_SEEDS = {"hanging": 4, "stretch": 2}
PARAMETER_STEP = 0.07
"""Relative change by which the responses to the seven parameters are found."""
SAME_STATE_M = 0.0003


@dataclass(frozen=True)
class CaptureTask:
    """One capture to explain.

    Attributes:
        id: of the capture.
        repeat: its number.
        depth: picture [m], float32 [H, W].
        scene: the simulation that should give it, without effects.
        sensor_known: the capture set states the sensor's noise and steps.
    """

    id: str
    repeat: int
    depth: NDArray[np.float32]
    scene: SimulationScene
    sensor_known: bool


@dataclass(frozen=True)
class FabricTask:
    """One fabric with its captures.

    Attributes:
        id: of the fabric.
        parameters: as stated (or estimated).
        relative_sigma: stated relative uncertainty of each parameter, [7].
        captures: its captures.
        effects: names of the effects to try.
        resolution_m: of the mesh.
    """

    id: str
    parameters: FabricParameters
    relative_sigma: tuple[float, ...]
    captures: tuple[CaptureTask, ...]
    effects: tuple[str, ...]
    resolution_m: float = 0.01


@dataclass(frozen=True)
class CaptureResult:
    """One capture's measurements and what explains them.

    Attributes:
        id, fabric, scene, repeat: of the capture.
        measured: features of the capture against its base state.
        jacobian: change of the shape-and-plane vector for a relative parameter change of one, [7, D].
        responses: effect name to the change of (vector [D], pixel statistics) at each of its nodes.
        reference: the base state's picture and cells.
        rms_m: of the capture against the base state.
        state: number of the base state among the fabric's and scene's; equal for repeats that fell into the same.
        sensor_known: the set states the sensor.
        sensed: pixel statistics that the stated sensor gives on the base state.
    """

    id: str
    fabric: str
    scene: str
    repeat: int
    measured: Features
    jacobian: NDArray[np.float64]
    responses: dict[str, list[tuple[NDArray[np.float64], NDArray[np.float64]]]]
    reference: Reference
    rms_m: float
    state: int
    sensor_known: bool
    sensed: NDArray[np.float64]


@dataclass(frozen=True)
class FabricResult:
    """All captures of a fabric, and what it cost."""

    task: FabricTask
    captures: tuple[CaptureResult, ...]
    cost: Cost = field(default_factory=Cost)


@dataclass
class _State:
    """A base state with its responses, shared by the captures that show it."""

    drape: KeyedDrape
    picture: NDArray[np.float32]
    reference: Reference
    fabric_drapes: list[KeyedDrape]
    effect_drapes: dict[tuple[str, int], KeyedDrape]


def explain_fabric(task: FabricTask, cache: DrapeCache) -> FabricResult:
    """Simulate what could explain the captures of one fabric.

    Raises:
        SimulationError: no base state of a scene came to rest.
    """
    simulator = Simulator(cache)
    results: list[CaptureResult] = []
    for name in sorted({c.scene.setup.scene.value for c in task.captures}):
        states: list[_State] = []
        for capture in (c for c in task.captures if c.scene.setup.scene.value == name):
            mesh = GridMesh(task.resolution_m, capture.scene.setup.sample_size_m)
            seeds = range(BASE_SEEDS[name])
            bases = [simulator.put_up(mesh, task.parameters, capture.scene, seed, BASE_JITTER) for seed in seeds]
            drape, rms = nearest_state(simulator, task.parameters, capture.scene, capture.depth, bases)
            number = _state_number(simulator, task, capture, drape, states)
            results.append(_explain_capture(task, capture, states[number], number, rms))
    return FabricResult(task, tuple(results), simulator.cost)


def _state_number(
    simulator: Simulator, task: FabricTask, capture: CaptureTask, drape: KeyedDrape, states: list[_State]
) -> int:
    picture = picture_of(drape.drape, capture.scene)
    for number, state in enumerate(states):
        if state.picture.shape == picture.shape and depth_rms(picture, state.picture) < SAME_STATE_M:
            return number
    fabric_drapes = [simulator.proceed(drape, _changed(task.parameters, index), capture.scene) for index in range(7)]
    effect_drapes = {}
    for name in task.effects:
        effect = get_effect(name)
        for number, size in enumerate(nodes(effect)):
            changed = effect.apply(capture.scene, size)
            if changed.setup != capture.scene.setup or changed.mechanics != capture.scene.mechanics:
                effect_drapes[name, number] = simulator.proceed(drape, task.parameters, changed)
    reference = make_reference(drape.drape, capture.scene)
    states.append(_State(drape, picture, reference, fabric_drapes, effect_drapes))
    return len(states) - 1


def _changed(parameters: FabricParameters, index: int) -> FabricParameters:
    values = parameters.as_array()
    values[index] *= 1 + PARAMETER_STEP
    return FabricParameters.from_array(values)


def _explain_capture(task: FabricTask, capture: CaptureTask, state: _State, number: int, rms: float) -> CaptureResult:
    reference = state.reference
    base = measure(state.picture, reference, with_pixels=False).vector()
    jacobian = np.stack(
        [
            _clean(measure(picture_of(d.drape, capture.scene), reference, with_pixels=False).vector() - base)
            / PARAMETER_STEP
            for d in state.fabric_drapes
        ]
    )
    responses: dict[str, list[tuple[NDArray[np.float64], NDArray[np.float64]]]] = {}
    sensed = _sensed(state.picture, capture.scene, reference)
    for name in task.effects:
        effect = get_effect(name)
        responses[name] = [
            _response(effect, size, capture.scene, state, state.effect_drapes.get((name, n)), base, sensed)
            for n, size in enumerate(nodes(effect))
        ]
    return CaptureResult(
        capture.id,
        task.id,
        capture.scene.setup.scene.value,
        capture.repeat,
        measure(capture.depth, reference),
        jacobian,
        responses,
        reference,
        rms,
        number,
        capture.sensor_known,
        sensed.pixels,
    )


def _response(
    effect: Effect,
    size: Size,
    scene: SimulationScene,
    state: _State,
    drape: KeyedDrape | None,
    base: NDArray[np.float64],
    sensed: Features,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    changed = effect.apply(scene, size)
    picture = picture_of((drape or state.drape).drape, changed)
    if effect.stage is Stage.SENSOR:
        features = _sensed(picture, changed, state.reference)
        return _clean(features.vector() - sensed.vector()), _clean(features.pixels - sensed.pixels)
    vector = measure(picture, state.reference, with_pixels=False).vector()
    return _clean(vector - base), np.zeros(len(sensed.pixels))


def _sensed(picture: NDArray[np.float32], scene: SimulationScene, reference: Reference) -> Features:
    """Features of a simulated picture with the sensor's noise, always the same noise."""
    noisy = scene.sensor.apply(picture, np.random.default_rng(0), camera=scene.camera)
    return measure(noisy, reference)


def _clean(change: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.isfinite(change), change, 0.0)


def relative_sigma(parameters_cv: float | None, density_cv: float | None, fallback: float) -> tuple[float, ...]:
    """Relative uncertainty of the seven parameters; ``fallback`` where none is stated."""
    stretch = fallback if parameters_cv is None else parameters_cv
    density = 0.02 if density_cv is None else density_cv
    return (*[stretch] * 6, density)


def with_effect(task: FabricTask, effect: Effect, size: Size) -> FabricTask:
    """The same task with an effect built into the baseline."""
    captures = tuple(replace(c, scene=effect.apply(c.scene, size)) for c in task.captures)
    return replace(task, captures=captures)
