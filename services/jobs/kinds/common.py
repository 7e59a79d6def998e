"""What jobs that simulate drapes have in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from pydantic import Field

from metric.backends import check_backend
from services.jobs.task import Report, Resources
from services.schemas import Number, Strict, Whole
from simcore.mesh import GridMesh

if TYPE_CHECKING:
    from metric.simulate import Runner, SimulationPlan


class SimulationInputs(Strict):
    """How fabrics are simulated and compared."""

    simulations: Whole = Field(default=5, ge=1, le=100, description="Simulations of each fabric in each scene.")
    backend: str = Field(
        default="lpips",
        max_length=40,
        description="Image distance: `lpips` as people see it, `depth` needs no weights.",
    )
    resolution_m: Number = Field(default=0.01, ge=0.002, le=0.05, description="Edge of a mesh cell [m].")
    seed: Whole = Field(default=0, ge=0, le=2**31 - 1)

    def plan(self) -> SimulationPlan:
        """The same for :mod:`metric.simulate`; this process does the work itself."""
        from metric.simulate import SimulationPlan

        return SimulationPlan(self.simulations, self.resolution_m, self.seed, workers=1)

    def check(self) -> None:
        """What can be known to fail before anything is simulated.

        Raises:
            InputError: an unknown back end, or a resolution that does not cut the sample into whole cells.
        """
        GridMesh(self.resolution_m)
        check_backend(self.backend)


def counting(report: Report, total: int, what: str) -> Callable[[], None]:
    """A callback that reports one more of ``total`` done at each call."""
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        report(done / total, f"{done} of {total} {what}")

    return advance


def simulation_runner(resources: Resources) -> Runner | None:
    """Where simulations run: a Ray cluster when the service has one, else in this process."""
    if resources.ray_address is None:
        return None
    from services.jobs.ray_tasks import ray_runner

    return ray_runner(resources.ray_address)
