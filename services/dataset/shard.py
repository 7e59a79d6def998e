"""The work of one shard: simulate, render, and gather the rows; every failure of a simulation is a row."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from diagnosis.scene import SimulationScene
from renderer.camera import CANONICAL_CAMERA
from renderer.depth_png import quantise_depth
from renderer.store import RowStatus, ShardRows
from renderer.store_format import DEPTH_UNIT_M, SCENE_CODES
from services.dataset.configuration import SweepConfiguration, simulation_seed
from services.dataset.extension import build_scene
from services.random_streams import SENSOR_STREAM
from simcore.batch.request import Request
from simcore.checks import check_request
from simcore.drape import Drape, DrapeStatus
from simcore.errors import DrapemeterError, MissingResourceError, OutOfMemoryError
from simcore.parameters import LIMITS, PARAMETER_NAMES, FabricParameters

if TYPE_CHECKING:
    from services.dataset.solving import DrapeSolver

_STATUS = {
    DrapeStatus.STILL: RowStatus.OK,
    DrapeStatus.NOT_STILL: RowStatus.NOT_STILL,
    DrapeStatus.UNDER_RESOLVED: RowStatus.UNDER_RESOLVED,
    DrapeStatus.DIVERGED: RowStatus.DIVERGED,
}

MACHINE = (OutOfMemoryError, MemoryError, MissingResourceError, OSError, ImportError)
"""Of the machine or its installation, not of a simulation: as rows they would fill a store that is never mended."""
FAILURES = (DrapemeterError, ArithmeticError, LookupError, RuntimeError, ValueError)
"""Of a simulation, whose rows say so; what else is raised is a fault of the program, and ends the sweep."""


@dataclass(frozen=True)
class Outcome:
    """How one simulation ended.

    Attributes:
        status, reason: of all its rows.
        drape: what the solver returned, None where it did not return.
        depth: 0.1 mm counts, uint16, shape [inclinations, height, width]; zeros unless ``status`` is OK.
    """

    status: RowStatus
    reason: str
    drape: Drape | None
    depth: NDArray[np.uint16]


@dataclass(frozen=True)
class ShardTask:
    """What a worker is told.

    Attributes:
        shard: its number.
        parameters: fabric of each of its simulations, SI, float32, shape [simulations, 7].
        given_up: simulations (by number) not to be tried, with status and reason, because they killed workers before.
        one_by_one: solve none ahead, because workers die here and it is to be seen of which simulation.
    """

    shard: int
    parameters: NDArray[np.float32]
    given_up: Mapping[int, tuple[RowStatus, str]]
    one_by_one: bool = False


def as_fabric(stored: NDArray[np.float32]) -> FabricParameters:
    """The fabric of a store's row, [7]; a limit that single precision rounded across is that limit.

    Raises:
        InputError: outside the limits.
    """
    values = stored.astype(np.float64)
    for place, name in enumerate(PARAMETER_NAMES):
        for limit in LIMITS[name]:
            if stored[place] == np.float32(limit):
                values[place] = limit
    return FabricParameters.from_array(values)


def shard_requests(task: ShardTask, configuration: SweepConfiguration) -> dict[int, Request]:
    """What a shard asks of a solver, by seed; simulations that cannot be asked for are refused in their turn."""
    layout = configuration.layout
    requests: dict[int, Request] = {}
    for number, fabric in zip(layout.shard_simulations(task.shard), task.parameters, strict=True):
        material, scene, jitter = layout.address(number)
        name = configuration.scenes[scene]
        seed = simulation_seed(configuration.seed, (material, SCENE_CODES[name], jitter))
        if number in task.given_up:
            continue
        try:
            cloth = as_fabric(fabric)
            built = build_scene(configuration, name, cloth, seed)
            check_request(configuration.mesh, built.setup, None, configuration.time_limit_s)
            requests[seed] = Request(cloth, built.setup, seed, mechanics=built.mechanics)
        except DrapemeterError:
            continue
    return requests


def simulate_shard(
    task: ShardTask, configuration: SweepConfiguration, solver: DrapeSolver
) -> Iterator[tuple[RowStatus, ShardRows]]:
    """Rows of each simulation of a shard in turn, with its status.

    Raises:
        OutOfMemoryError, MemoryError, MissingResourceError, OSError, ImportError: see :func:`simulate_and_render`.
    """
    layout = configuration.layout
    for number, fabric in zip(layout.shard_simulations(task.shard), task.parameters, strict=True):
        material, scene, jitter = layout.address(number)
        scene_name = configuration.scenes[scene]
        code = SCENE_CODES[scene_name]
        seed = simulation_seed(configuration.seed, (material, code, jitter))
        if number in task.given_up:
            outcome = Outcome(*task.given_up[number], drape=None, depth=_no_depth(configuration))
        else:
            outcome = simulate_and_render(fabric, scene_name, seed, configuration, solver)
        yield outcome.status, _rows(outcome, fabric, (material, code, jitter), seed, configuration)


def simulate_and_render(
    fabric: NDArray[np.float32], scene: str, seed: int, configuration: SweepConfiguration, solver: DrapeSolver
) -> Outcome:
    """One simulation with its pictures. What goes wrong in it (:data:`FAILURES`) is told in the outcome, not raised.

    Raises:
        OutOfMemoryError, MemoryError, MissingResourceError, OSError, ImportError: the machine's fault, which says
            nothing of the simulation.
    """
    nothing = _no_depth(configuration)
    try:
        cloth = as_fabric(fabric)
        built = build_scene(configuration, scene, cloth, seed)
        drape = solver.solve(
            cloth,
            built.setup,
            seed=seed,
            mechanics=built.mechanics,
            time_limit_s=configuration.time_limit_s,
        )
    except MACHINE:
        raise
    except FAILURES as error:
        refused = isinstance(error, DrapemeterError)
        status = RowStatus.REFUSED if refused else RowStatus.CRASHED
        return Outcome(status, f"{type(error).__name__}: {error}", None, nothing)
    status = _STATUS[drape.status]
    if status is not RowStatus.OK:
        if status is RowStatus.NOT_STILL and drape.seconds >= configuration.time_limit_s:
            status = RowStatus.TIMED_OUT
        return Outcome(status, drape.reason or drape.status.value, drape, nothing)
    try:
        depth = render_pictures(drape, built, configuration)
        fault = picture_fault(depth)
        counts = quantise_depth(apply_sensor(depth, seed, built), DEPTH_UNIT_M)
    except MACHINE:
        raise
    except FAILURES as error:
        return Outcome(RowStatus.BAD_RENDER, f"{type(error).__name__}: {error}", drape, nothing)
    if not counts.reshape(len(counts), -1).any(axis=1).all():
        fault = fault or "the sensor reads nothing"
    if fault:
        return Outcome(RowStatus.BAD_RENDER, fault, drape, nothing)
    return Outcome(RowStatus.OK, "", drape, counts)


def render_pictures(drape: Drape, scene: SimulationScene, configuration: SweepConfiguration) -> NDArray[np.float32]:
    """Depth of a drape at every inclination [m], float32, shape [inclinations, height, width]."""
    from renderer.depth import render_depths

    return render_depths(
        drape.vertices, drape.mesh.triangles, scene.camera, scene.camera_from_panel, configuration.inclinations_deg
    )


def apply_sensor(depth: NDArray[np.float32], seed: int, scene: SimulationScene) -> NDArray[np.float32]:
    """Depth as the scene's sensor gives it [m], same shape; each picture has a random stream of its own."""
    if scene.sensor.off:
        return depth
    streams = np.random.SeedSequence(seed, spawn_key=(SENSOR_STREAM,)).spawn(len(depth))
    return np.stack(
        [
            scene.sensor.apply(picture, np.random.default_rng(stream), camera=scene.camera)
            for picture, stream in zip(depth, streams, strict=True)
        ]
    )


def picture_fault(depth: NDArray[np.float32]) -> str:
    """What is wrong with depth pictures, shape [pictures, height, width]; empty when they may be used."""
    flat = depth.reshape(len(depth), -1)
    if not np.isfinite(flat).all():
        return "depth is not finite"
    if (flat.max(axis=1) <= 0.0).any():
        return "nothing is seen"
    if (flat.max(axis=1) == flat.min(axis=1)).any():
        return "the picture is constant"
    return ""


def _no_depth(configuration: SweepConfiguration) -> NDArray[np.uint16]:
    return np.zeros((configuration.inclinations, CANONICAL_CAMERA.height, CANONICAL_CAMERA.width), dtype=np.uint16)


def _rows(
    outcome: Outcome,
    fabric: NDArray[np.float32],
    address: tuple[int, int, int],
    seed: int,
    configuration: SweepConfiguration,
) -> ShardRows:
    count = configuration.inclinations
    drape = outcome.drape
    vertices = np.full((1, configuration.mesh.vertex_count, 3), np.nan, dtype=np.float32)
    if drape is not None:
        vertices[0] = drape.vertices
    material, code, jitter = address
    return ShardRows(
        depth=outcome.depth,
        parameters=np.repeat(fabric[None], count, axis=0),
        scene=np.full(count, code, dtype=np.uint8),
        status=np.full(count, outcome.status, dtype=np.uint8),
        reason=np.full(count, " ".join(outcome.reason.split())[:300], dtype=object),
        inclination_deg=np.asarray(configuration.inclinations_deg, dtype=np.float32),
        seed=np.full(count, seed, dtype=np.uint64),
        material=np.full(count, material, dtype=np.uint32),
        jitter=np.full(count, jitter, dtype=np.uint32),
        vertices=vertices,
        residual=np.array([np.nan if drape is None else drape.residual]),
        energy=np.array([np.nan if drape is None else drape.energy]),
    )
