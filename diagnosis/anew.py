"""A second round for sets without parameters: these are estimated again with what the first round named."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from capture.capture_set import CaptureSet
from capture.prepare import prepare_all
from diagnosis.extension import SimulatorExtension
from diagnosis.indirect_estimate import IndirectEstimator
from diagnosis.report import GapReport
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Cost, Simulator
from diagnosis.tasks.fabric_task import FabricTask
from diagnosis.tasks.parameters import shipped_estimator, uncertainty
from simcore.errors import InputError, SimulationError
from simcore.parameters import ESTIMATED_NAMES, FabricParameters

WORTH = 0.5
"""Where no estimate moves by more than so many of its standard deviations everything stays as it is."""

NO_MORE = (
    "parameters were estimated again with what is named in the simulations; with these something else is named, or "
    "held-out captures come no nearer, so that the answer is that of the first estimates"
)
"""Said of a second round that does not answer."""


@dataclass(frozen=True)
class Anew:
    """Fabrics with their parameters estimated again.

    Attributes:
        tasks: of all fabrics; empty where nothing moves by enough, or nothing could be simulated.
        said: in words, what was done, or why not.
        cost: of the simulations.
    """

    tasks: tuple[FabricTask, ...] = ()
    said: tuple[str, ...] = ()
    cost: Cost = field(default_factory=Cost)


def estimated_anew(
    captures: CaptureSet,
    tasks: Sequence[FabricTask],
    found: SimulatorExtension,
    cache: DrapeCache,
    resolution_m: float,
) -> Anew:
    """Estimate fabrics that state no parameters again, with effects in the simulations.

    Args:
        captures: the set.
        tasks: of its fabrics.
        found: what is named, with sizes.
        cache: of simulated drapes.
        resolution_m: of the mesh.
    """
    simulator = Simulator(cache)
    names = " and ".join(effect.name for effect in found.effects)
    better: dict[str, FabricTask] = {}
    said, worth = [], False
    try:
        indirect = IndirectEstimator(
            captures, prepare_all(captures.captures), found, shipped_estimator(), simulator, resolution_m
        )
        for task in (task for task in tasks if task.estimated):
            estimate = indirect.estimate(task.id, task.parameters.density).estimate
            moved = [math.log(estimate.parameters[n] / getattr(task.parameters, n)) for n in ESTIMATED_NAMES]
            known = task.relative_sigma[len(ESTIMATED_NAMES) :]
            worth |= any(abs(m) > WORTH * s for m, s in zip(moved, task.relative_sigma, strict=False))
            parameters = FabricParameters.from_mapping({**estimate.parameters, "density": task.parameters.density})
            better[task.id] = replace(task, parameters=parameters, relative_sigma=(*uncertainty(estimate), *known))
            times = ", ".join(f"{n} {math.exp(m):.2g}" for n, m in zip(ESTIMATED_NAMES, moved, strict=True))
            said.append(f"fabric {task.id}: estimated again with {names} in the simulations, times the first: {times}")
    except (InputError, SimulationError) as error:
        return Anew(
            (), (f"parameters could not be estimated again with {names} in the simulations: {error}",), simulator.cost
        )
    if not worth:
        return Anew((), (), simulator.cost)
    return Anew(tuple(better.get(task.id, task) for task in tasks), tuple(said), simulator.cost)


def says_more(again: GapReport, first: GapReport) -> bool:
    """The same is named, and captures that were held out come nearer.

    A second effect that comes in with other estimates may stand for what these are off by.
    """
    if again.shrinkage is None or first.shrinkage is None or again.shrinkage.unit != first.shrinkage.unit:
        return False
    named = [{effect.name for effect in report.cause.effects} for report in (again, first)]
    return named[0] == named[1] and again.shrinkage.after < first.shrinkage.after
