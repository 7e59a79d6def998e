"""All simulations that the diagnosis of one fabric needs, in one process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.measurement.features import Features, measure
from diagnosis.measurement.nearness import no_further
from diagnosis.measurement.picture import noise_square, picture_of
from diagnosis.measurement.reference import Reference, make_reference
from diagnosis.scene import SimulationScene, put_up_alike
from diagnosis.simulation.base_state import nearest_state
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.missed_folds import further_states, is_missed
from diagnosis.simulation.pose_error import pose_responses
from diagnosis.simulation.responses import Responses, borrowed_responses
from diagnosis.simulation.simulator import Cost, KeyedDrape, Simulator
from diagnosis.simulation.warps import warp_responses
from diagnosis.tasks.enough import check_seen
from simcore.drape import OUT_OF_TIME
from simcore.errors import InputError
from simcore.mechanics import Jitter
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

BASE_JITTER = Jitter(force_weights=1.0, pin_m=0.0, placement_m=0.02)
BASE_SEEDS = {"hanging": 4, "stretch": 2}
STATED_DENSITY_SIGMA = 0.02
"""Relative uncertainty of a density that a set states without saying how well it is known."""


@dataclass(frozen=True)
class CaptureTask:
    """One capture to explain.

    Attributes:
        id: of the capture.
        repeat: its number.
        depth: picture [m], float32 [H, W].
        scene: the simulation that should give it, without effects.
        sensor_known: the capture set states the sensor's noise and steps.
        pose_error_m: what the camera's pose, found in the pictures, may be off by along the panel [m]; 0: it is stated.
    """

    id: str
    repeat: int
    depth: NDArray[np.float32]
    scene: SimulationScene
    sensor_known: bool
    pose_error_m: float = 0.0

    @property
    def pose_known(self) -> bool:
        """The capture set states the camera's pose."""
        return self.pose_error_m == 0.0


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
        estimated: nobody stated the parameters; they are estimated from these captures.
    """

    id: str
    parameters: FabricParameters
    relative_sigma: tuple[float, ...]
    captures: tuple[CaptureTask, ...]
    effects: tuple[str, ...]
    resolution_m: float = 0.01
    estimated: bool = False


def with_grip(task: FabricTask, pin_radius_m: float) -> FabricTask:
    """The same fabric with magnets that hold all cloth this near to a corner [m]."""
    captures = []
    for capture in task.captures:
        setup = replace(capture.scene.setup, pin_radius_m=pin_radius_m)
        captures.append(replace(capture, scene=capture.scene.with_setup(setup)))
    return replace(task, captures=tuple(captures))


@dataclass(frozen=True)
class CaptureResult:
    """One capture's measurements and what explains them.

    Attributes:
        id, fabric, scene, repeat: of the capture.
        measured: features of the capture against its base state.
        responses: what parameters, pins, mesh and effects change.
        reference: the base state's picture and cells.
        rms_m: of the capture against the base state.
        state: number of the base state among the fabric's and scene's; equal for repeats that fell into the same.
        sensor_known: the set states the sensor.
        base: the base state.
        pose_known: the set states the camera's pose.
        warps: see :func:`diagnosis.simulation.warps.warp_responses`.
        pose: see :func:`diagnosis.simulation.pose_error.pose_responses`.
        noise_m2: what of the square of ``rms_m`` the sensor's noise is said to make [m²].
        setup: number of its set-up among the fabric's and scene's; equal for those that repeat each other.
    """

    id: str
    fabric: str
    scene: str
    repeat: int
    measured: Features
    responses: Responses
    reference: Reference
    rms_m: float
    state: int
    sensor_known: bool
    base: KeyedDrape
    pose_known: bool
    warps: NDArray[np.float64]
    pose: NDArray[np.float64] | None = None
    noise_m2: float = 0.0
    setup: int = 0


@dataclass(frozen=True)
class FabricResult:
    """All captures of a fabric, and what it cost."""

    task: FabricTask
    captures: tuple[CaptureResult, ...]
    cost: Cost = field(default_factory=Cost)


def not_at_rest(results: Sequence[FabricResult]) -> list[str]:
    """In words, fabrics whose nearest simulation is none that came to rest."""
    found = {
        (r.task.id, c.scene): c.base.drape.reason or c.base.drape.status.value
        for r in results
        for c in r.captures
        if not c.base.drape.ok
    }
    return [
        f"fabric {name} in {scene} is compared with a simulation that is not at rest ({why}): use a "
        f"{'coarser' if why.startswith(OUT_OF_TIME) else 'finer'} --resolution"
        for (name, scene), why in found.items()
    ]


@dataclass(frozen=True)
class SeenState:
    """A base state as one camera sees it, with what its variations look like."""

    drape: KeyedDrape
    scene: SimulationScene
    reference: Reference
    responses: Responses
    warps: NDArray[np.float64]


def explain_fabric(task: FabricTask, cache: DrapeCache) -> FabricResult:
    """Simulate what could explain the captures of one fabric.

    Raises:
        InputError: a capture shows too little of the cloth.
        SimulationError: all base states of a scene have diverged.
    """
    simulator = Simulator(cache)
    results: list[CaptureResult] = []
    for name in sorted({c.scene.setup.scene.value for c in task.captures}):
        own = [c for c in task.captures if c.scene.setup.scene.value == name]
        keys: list[str] = []
        setups: list[Setup] = []
        states: list[SeenState] = []
        try:
            nearest = find_states(simulator, task, own)
        except InputError as error:
            raise InputError(f"fabric {task.id} in {name}: {error}", code=error.code) from None
        for capture, (drape, rms) in zip(own, nearest, strict=True):
            if drape.key not in keys:
                keys.append(drape.key)
            state = next((s for s in states if s.drape.key == drape.key and s.scene == capture.scene), None)
            reference = make_reference(drape.drape, capture.scene) if state is None else state.reference
            measured = measure(capture.depth, reference)
            check_seen(capture.id, measured, reference)
            if state is None:
                state = see_state(simulator, task, capture.scene, drape, reference)
                states.append(state)
            results.append(
                CaptureResult(
                    capture.id,
                    task.id,
                    name,
                    capture.repeat,
                    measured,
                    state.responses,
                    state.reference,
                    rms,
                    keys.index(drape.key),
                    capture.sensor_known,
                    drape,
                    capture.pose_known,
                    state.warps,
                    pose_responses(drape.drape, capture.scene, state.reference, capture.pose_error_m),
                    noise_square(capture.scene),
                    _setup_number(capture.scene.setup, setups),
                )
            )
    return FabricResult(task, tuple(results), simulator.cost)


def _setup_number(setup: Setup, known: list[Setup]) -> int:
    """Number of a set-up among those that captures were put up in; a new one joins them."""
    for number, other in enumerate(known):
        if put_up_alike(setup, other):
            return number
    known.append(setup)
    return len(known) - 1


def find_states(
    simulator: Simulator, task: FabricTask, captures: Sequence[CaptureTask]
) -> list[tuple[KeyedDrape, float]]:
    """The fold state nearest to each of a scene's captures, and its distance from it [m].

    Where one repeat is far from any, it is sought again among more (:mod:`diagnosis.simulation.missed_folds`).
    """
    found: list[tuple[Setup, str, float]] = []
    nearest = []
    for capture in captures:
        setup = capture.scene.setup  # states of another one say nothing of this one's
        known: dict[str, float] = {}
        for other, key, rms in found:
            if other == setup:
                known[key] = min(rms, known.get(key, rms))
        drape, rms = find_state(simulator, task, capture, known)
        found.append((setup, drape.key, rms))
        nearest.append((drape, rms))
    beyond = [rms**2 - noise_square(c.scene) for (_, rms), c in zip(nearest, captures, strict=True)]
    setups = [c.scene.setup for c in captures]
    for number, capture in enumerate(captures):
        alike = [b for b, setup in zip(beyond, setups, strict=True) if put_up_alike(setups[number], setup)]
        if is_missed(beyond[number], alike, capture.scene):
            again = find_state(simulator, task, capture, further=True)
            nearest[number] = min(nearest[number], again, key=lambda one: (not one[0].drape.ok, one[1]))
    return nearest


def find_state(
    simulator: Simulator,
    task: FabricTask,
    capture: CaptureTask,
    found: dict[str, float] | None = None,
    *,
    further: bool = False,
) -> tuple[KeyedDrape, float]:
    """The fold state nearest to a capture, and its distance from it [m].

    Args:
        simulator, task, capture: what is looked for.
        found: states that earlier repeats showed, by key, with their distance [m].
        further: look among the states of more samples.
    """
    mesh = GridMesh(task.resolution_m, capture.scene.setup.sample_size_m)
    bases = base_states(simulator, task.parameters, capture.scene, mesh)
    if further:
        bases += further_states(simulator, task.parameters, capture.scene, mesh)
    enough = {key: no_further(rms, capture.scene) for key, rms in (found or {}).items()}
    return nearest_state(simulator, task.parameters, capture.scene, capture.depth, bases, enough)


def base_states(
    simulator: Simulator, fabric: FabricParameters, scene: SimulationScene, mesh: GridMesh
) -> list[KeyedDrape]:
    """States put up from several seeds, before any capture is seen."""
    seeds = range(BASE_SEEDS[scene.setup.scene.value])
    return [simulator.put_up(mesh, fabric, scene, seed, BASE_JITTER) for seed in seeds]


def see_state(
    simulator: Simulator,
    task: FabricTask,
    scene: SimulationScene,
    drape: KeyedDrape,
    reference: Reference | None = None,
) -> SeenState:
    """A state's picture (``reference``, where it was rendered already) and responses, simulated where not kept."""
    reference = reference or make_reference(drape.drape, scene)
    picture = picture_of(drape.drape, scene)
    responses = borrowed_responses(simulator, task.parameters, scene, drape, task.effects, picture, reference)
    return SeenState(drape, scene, reference, responses, warp_responses(reference, scene.camera))


def relative_sigma(parameters_cv: float, density_cv: float | None) -> tuple[float, ...]:
    """Relative uncertainty of the seven parameters; the density's is usual where none is stated."""
    density = STATED_DENSITY_SIGMA if density_cv is None else density_cv
    return (*[parameters_cv] * 6, density)
