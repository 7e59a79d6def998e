"""All simulations that the diagnosis of one fabric needs, in one process."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.base_state import depth_rms, nearest_state, picture_of
from diagnosis.drape_cache import DrapeCache
from diagnosis.effect import Stage
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
COARSE_TOO_FAR_M = 0.004
"""A coarse state further from its fine origin than this fell into other folds and is not used."""


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


@dataclass(frozen=True)
class _State:
    """A base state with what it turns into, shared by the captures that show it.

    ``drape`` is fine; ``origin`` is the same state on the mesh of the variations, which start from it.
    """

    drape: KeyedDrape
    picture: NDArray[np.float32]
    reference: Reference
    origin: KeyedDrape
    coarse: Reference
    parameters: tuple[KeyedDrape, ...]
    effects: dict[tuple[str, int], KeyedDrape]


def explain_fabric(task: FabricTask, cache: DrapeCache) -> FabricResult:
    """Simulate what could explain the captures of one fabric.

    Raises:
        SimulationError: no base state of a scene came to rest.
    """
    simulator = Simulator(cache)
    results: list[CaptureResult] = []
    for name in sorted({c.scene.setup.scene.value for c in task.captures}):
        states: list[_State] = []
        seen: list[tuple[int, SimulationScene, _Responses]] = []
        for capture in (c for c in task.captures if c.scene.setup.scene.value == name):
            drape, rms = find_state(simulator, task, capture)
            number = next((n for n, state in enumerate(states) if state.drape.key == drape.key), len(states))
            if number == len(states):
                states.append(_vary(simulator, task, capture, drape))
            known = next((r for n, scene, r in seen if n == number and scene == capture.scene), None)
            if known is None:
                known = _look(task, capture.scene, states[number])
                seen.append((number, capture.scene, known))
            results.append(_explain_capture(task, capture, states[number], known, number, rms))
    return FabricResult(task, tuple(results), simulator.cost)


def find_state(simulator: Simulator, task: FabricTask, capture: CaptureTask) -> tuple[KeyedDrape, float]:
    """The fold state nearest to a capture, and its distance from it [m]."""
    mesh = GridMesh(task.resolution_m, capture.scene.setup.sample_size_m)
    seeds = range(BASE_SEEDS[capture.scene.setup.scene.value])
    bases = [simulator.put_up(mesh, task.parameters, capture.scene, seed, BASE_JITTER) for seed in seeds]
    return nearest_state(simulator, task.parameters, capture.scene, capture.depth, bases)


def _vary(simulator: Simulator, task: FabricTask, capture: CaptureTask, drape: KeyedDrape) -> _State:
    """Let the state go on with each parameter and each effect changed."""
    scene = capture.scene
    origin = simulator.coarser(drape, task.parameters, scene)
    if depth_rms(picture_of(origin.drape, scene), picture_of(drape.drape, scene)) > COARSE_TOO_FAR_M:
        origin = drape
    parameters = tuple(simulator.proceed(origin, _changed(task.parameters, index), scene) for index in range(7))
    effects = {}
    for name in task.effects:
        effect = get_effect(name)
        for number, size in enumerate(nodes(effect)):
            changed = effect.apply(scene, size)
            if changed.setup != scene.setup or changed.mechanics != scene.mechanics:
                effects[name, number] = simulator.proceed(origin, task.parameters, changed)
    picture = picture_of(drape.drape, scene)
    coarse = make_reference(origin.drape, _smaller(scene), least_pixels=3)
    return _State(drape, picture, make_reference(drape.drape, scene), origin, coarse, parameters, effects)


def _smaller(scene: SimulationScene) -> SimulationScene:
    """The scene seen by half as many pixels each way, for pictures without noise; unchanged where that is not whole."""
    camera = scene.camera
    if camera.width % 2 or camera.height % 2 or camera.width < 400:
        return scene
    return replace(scene, camera=camera.scaled(0.5))


def _changed(parameters: FabricParameters, index: int) -> FabricParameters:
    values = parameters.as_array()
    values[index] *= 1 + PARAMETER_STEP
    return FabricParameters.from_array(values)


@dataclass(frozen=True)
class _Responses:
    """A state's variations as one camera and sensor see them; see :class:`CaptureResult`."""

    jacobian: NDArray[np.float64]
    effects: dict[str, list[tuple[NDArray[np.float64], NDArray[np.float64]]]]
    sensed: NDArray[np.float64]


def _look(task: FabricTask, scene: SimulationScene, state: _State) -> _Responses:
    """Render all variations and measure what they change."""

    def vector(drape: KeyedDrape, seen: SimulationScene) -> NDArray[np.float64]:
        return measure(picture_of(drape.drape, _smaller(seen)), state.coarse, with_pixels=False).vector()

    base = vector(state.origin, scene)
    jacobian = np.stack([_clean(vector(d, scene) - base) / PARAMETER_STEP for d in state.parameters])
    sensed = _sensed(state.picture, scene, state.reference)
    still = np.zeros(len(sensed.pixels))
    responses: dict[str, list[tuple[NDArray[np.float64], NDArray[np.float64]]]] = {}
    for name in task.effects:
        effect = get_effect(name)
        responses[name] = []
        for n, size in enumerate(nodes(effect)):
            changed = effect.apply(scene, size)
            if effect.stage is Stage.SENSOR:
                features = _sensed(state.picture, changed, state.reference)
                change = _clean(features.vector() - sensed.vector()), _clean(features.pixels - sensed.pixels)
            elif changed != scene:
                change = _clean(vector(state.effects.get((name, n), state.origin), changed) - base), still
            else:
                change = np.zeros(len(base)), still
            responses[name].append(change)
    return _Responses(jacobian, responses, sensed.pixels)


def _explain_capture(
    task: FabricTask, capture: CaptureTask, state: _State, seen: _Responses, number: int, rms: float
) -> CaptureResult:
    return CaptureResult(
        capture.id,
        task.id,
        capture.scene.setup.scene.value,
        capture.repeat,
        measure(capture.depth, state.reference),
        seen.jacobian,
        seen.effects,
        state.reference,
        rms,
        number,
        capture.sensor_known,
        seen.sensed,
    )


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
