"""What a sweep will cost, before it starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.dataset.configuration import SweepConfiguration
from services.dataset.solver_kind import SolverKind

# Measured on one core (docs/benchmarks.md, "Dataset service"), fabrics of the prior, both scenes together.
_VERTICES = (121.0, 676.0, 2601.0, 10201.0)
_SECONDS_A_SIMULATION = (0.2, 0.62, 1.98, 7.87)
_SECONDS_A_PICTURE = 0.006
_BYTES_A_PICTURE = 15e3
_BYTES_A_VERTEX = 11.0


@dataclass(frozen=True)
class CostEstimate:
    """Expected size of a sweep.

    Attributes:
        simulations, pictures: counts.
        core_hours: CPU time.
        hours: wall-clock time on the given workers, one core each.
        gigabytes: size of the store.
        workers: what ``hours`` is for.
        note: what the times do not tell; empty for the solver that they were measured with.
    """

    simulations: int
    pictures: int
    core_hours: float
    hours: float
    gigabytes: float
    workers: int
    note: str = ""


def estimate_cost(configuration: SweepConfiguration, workers: int, simulations: int | None = None) -> CostEstimate:
    """Cost from measured times and sizes, interpolated over the mesh's size; good to a factor of two.

    Args:
        configuration: the sweep.
        workers: worker processes, one core each.
        simulations: only so many are still to be done.
    """
    count = configuration.layout.simulations if simulations is None else simulations
    vertices = configuration.mesh.vertex_count
    solve = float(np.exp(np.interp(np.log(vertices), np.log(_VERTICES), np.log(_SECONDS_A_SIMULATION))))
    solve *= max(1.0, vertices / _VERTICES[-1])
    pictures = count * configuration.inclinations
    seconds = count * solve + pictures * _SECONDS_A_PICTURE
    size = pictures * _BYTES_A_PICTURE + count * vertices * _BYTES_A_VERTEX
    measured = configuration.solver is SolverKind.SINGLE
    note = "" if measured else f"times of solver single; those of solver {configuration.solver.value} are not known"
    return CostEstimate(count, pictures, seconds / 3600, seconds / 3600 / workers, size / 1e9, workers, note)
