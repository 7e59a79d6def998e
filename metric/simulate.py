"""Renders of simulated fabrics: several jittered simulations in each scene, in worker processes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from metric.draping import DrapeRequest, RequestResult, run_request
from metric.engine import engine_fingerprint
from metric.render import DrapeRender
from metric.render_cache import RenderCache
from metric.workers import run_in_processes
from simcore.cores import usable_cores
from simcore.errors import InputError, MissingResourceError, SimulationError
from simcore.parameters import FabricParameters
from simcore.scenes import Scene

SCENES: tuple[Scene, ...] = (Scene.HANGING, Scene.STRETCH)
MOST_SIMULATIONS = 1000


@dataclass(frozen=True)
class Retry:
    """A simulation that did not come to rest and was done again from other initial forces.

    Attributes:
        fabric: its place among the fabrics that were simulated together.
        scene: where.
        repeat: which of the repeats.
        reasons: why each failed attempt failed.
    """

    fabric: int
    scene: Scene
    repeat: int
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class FabricRenders:
    """One fabric's renders.

    Attributes:
        fabric: its parameters.
        scenes: renders by scene, one a repeat.
        retries: simulations that needed more than one attempt.
        failure: why it could not be simulated (``scenes`` is then incomplete); "" where every simulation came to rest.
    """

    fabric: FabricParameters
    scenes: dict[Scene, list[DrapeRender]]
    retries: list[Retry] = field(default_factory=list)
    failure: str = ""


@dataclass(frozen=True)
class SimulationPlan:
    """How a fabric is simulated.

    Attributes:
        simulations: repeats in each scene (the paper's N).
        resolution_m: edge of a mesh cell [m].
        seed: of all random numbers.
        scenes: which scenes.
        attempts: how often a simulation that does not come to rest is tried with other initial forces.
        workers: processes; 0 for one a core, 1 for this process itself.

    Raises:
        InputError: a number out of range.
    """

    simulations: int = 5
    resolution_m: float = 0.01
    seed: int = 0
    scenes: tuple[Scene, ...] = SCENES
    attempts: int = 3
    workers: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.simulations <= MOST_SIMULATIONS:
            raise InputError(
                f"simulations must be from 1 to {MOST_SIMULATIONS}, got {self.simulations}: the paper takes 5",
                code="simulations_out_of_range",
            )
        if self.seed < 0:
            raise InputError(f"the seed must not be negative, got {self.seed}", code="seed_out_of_range")
        if self.workers < 0 or self.attempts < 1 or not self.scenes:
            raise InputError("workers must be >= 0, attempts >= 1 and at least one scene given", code="plan_bad")


Runner = Callable[[Sequence[DrapeRequest]], Iterator[RequestResult]]
"""Runs requests in any order, each once; a Ray cluster may stand behind it."""


def samples_apart(fabrics: Sequence[FabricParameters], plan: SimulationPlan) -> list[int]:
    """Numbers of first repeats with which fabrics of equal numbers are independent samples, never the same pictures."""
    seen: Counter[FabricParameters] = Counter()
    firsts = []
    for fabric in fabrics:
        firsts.append(seen[fabric] * plan.simulations)
        seen[fabric] += 1
    return firsts


def simulate_fabrics(
    fabrics: Sequence[FabricParameters],
    plan: SimulationPlan,
    *,
    first_repeats: Sequence[int] | None = None,
    runner: Runner | None = None,
    cache: RenderCache | None = None,
    keep_failures: bool = False,
    on_done: Callable[[], None] | None = None,
) -> list[FabricRenders]:
    """Simulate and render each fabric ``plan.simulations`` times in each scene.

    The initial forces of a repeat depend on the seed, the fabric's numbers, the scene and the repeat alone: two
    different fabrics are independent samples, and the same call gives the same pictures.

    Args:
        fabrics: the fabrics.
        plan: how often, how fine, which scenes.
        first_repeats: number of each fabric's first repeat; a second sample of one fabric takes up where the first
            ended.
        runner: executes the requests; by default worker processes as the plan says.
        cache: keeps renders, and what does not come to rest, between processes.
        keep_failures: return fabrics that could not be simulated with their ``failure`` instead of raising.
        on_done: called after each simulation.

    Raises:
        SimulationError: a simulation did not come to rest in any attempt, or a worker process died.
        MissingResourceError: workers have other code or libraries than this process.
    """
    firsts = list(first_repeats) if first_repeats is not None else [0] * len(fabrics)
    requests = [
        DrapeRequest(fabric, scene, first + repeat, plan.seed, plan.resolution_m, plan.attempts)
        for fabric, first in zip(fabrics, firsts, strict=True)
        for scene in plan.scenes
        for repeat in range(plan.simulations)
    ]
    results: dict[DrapeRequest, RequestResult] = {}
    missing: dict[DrapeRequest, DrapeRequest] = {}
    for request in requests:
        found = cache.load(request) if cache is not None else None
        if found is None:
            missing[request] = request
        elif not found.settled:
            missing[request] = replace(request, failures=found.failures)
        else:
            results[request] = found
            _call(on_done)
    run = runner if runner is not None else local_runner(plan.workers)
    for result in run(list(missing.values())):
        _require_same(result)
        results[result.request] = result
        if cache is not None:
            cache.save(result)
        _call(on_done)
    if cache is not None and missing:
        cache.trim()
    gathered = [
        _gather(place, fabric, [results[r] for r in requests if r.fabric == fabric and _within(r, first, plan)], plan)
        for place, (fabric, first) in enumerate(zip(fabrics, firsts, strict=True))
    ]
    failed = [g for g in gathered if g.failure]
    if failed and not keep_failures:
        raise SimulationError(
            f"{len(failed)} of {len(gathered)} fabrics could not be simulated, the first with density "
            f"{failed[0].fabric.density:g} kg/m²: {failed[0].failure}; try another --seed or a finer --resolution",
            code="simulation_not_still",
        )
    return gathered


def local_runner(workers: int) -> Runner:
    """Runs requests in this process (``workers`` = 1) or in spawned worker processes (0: one a core)."""

    def run(requests: Sequence[DrapeRequest]) -> Iterator[RequestResult]:
        count = min(workers or usable_cores(), len(requests))
        if count <= 1:
            yield from map(run_request, requests)
            return
        yield from run_in_processes(run_request, requests, count)

    return run


def _within(request: DrapeRequest, first: int, plan: SimulationPlan) -> bool:
    return first <= request.repeat < first + plan.simulations


def _gather(place: int, fabric: FabricParameters, results: list[RequestResult], plan: SimulationPlan) -> FabricRenders:
    scenes: dict[Scene, list[DrapeRender]] = {scene: [] for scene in plan.scenes}
    retries: list[Retry] = []
    lost: list[RequestResult] = []
    for result in sorted({r.request: r for r in results}.values(), key=lambda r: r.request.repeat):
        if result.render is None:
            lost.append(result)
            continue
        scenes[result.request.scene].append(result.render)
        if result.failures:
            retries.append(Retry(place, result.request.scene, result.request.repeat, result.failures))
    failure = ""
    if lost:
        reasons = "; ".join(dict.fromkeys(lost[0].failures))
        failure = f"{len(lost)} of {len(results)} simulations did not come to rest ({lost[0].request.scene}: {reasons})"
    return FabricRenders(fabric, scenes, retries, failure)


def _require_same(result: RequestResult) -> None:
    """Drapes of another solver are no repeats of ours, and must not be kept as such.

    Raises:
        MissingResourceError: a worker has other code or libraries than this process.
    """
    if result.engine and result.engine != engine_fingerprint():
        raise MissingResourceError(
            "the workers that simulate have another version of the program or of its libraries than this process: "
            "install the same on all nodes, and start them again",
            code="workers_version",
        )


def _call(on_done: Callable[[], None] | None) -> None:
    if on_done is not None:
        on_done()
