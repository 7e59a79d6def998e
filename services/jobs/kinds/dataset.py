"""Job ``dataset``: a sweep of fabrics, scenes and repeats into a store."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import ConfigDict, Field

from services.jobs.task import Report, Task, TaskOutput
from services.patterns import PRINTABLE
from services.schemas import Number, Strict, Whole
from simcore.errors import DrapemeterError

if TYPE_CHECKING:
    from services.dataset.configuration import SweepConfiguration
    from services.dataset.cost import CostEstimate
    from services.dataset.fabrics import FabricTable
    from services.dataset.worker import SimulationDone

OF_ANOTHER_VERSION = frozenset({"store_version", "store_configuration", "store_schema"})
"""Why a store is not gone on with: what a job asks for is the same at each attempt, so the software was changed."""


class SimulatorEffect(Strict):
    """An effect that is simulated beyond the baseline."""

    name: str = Field(max_length=60, pattern=PRINTABLE, description="As in the catalogue of effects.")
    size: dict[Annotated[str, Field(max_length=60, pattern=PRINTABLE)], Number] = Field(
        max_length=8, description="Its components, in the effect's unit; `magnitude` for one number."
    )


class SimulatorDocument(Strict):
    """What `drapemeter diagnose --apply` writes."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "format": "drapemeter-simulator/1",
                    "effects": [{"name": "air_draft", "size": {"magnitude": 0.3}}],
                }
            ]
        }
    )

    format: Literal["drapemeter-simulator/1"] = "drapemeter-simulator/1"
    effects: tuple[SimulatorEffect, ...] = Field(max_length=8)
    pin_radius_m: Number | None = Field(
        default=None, ge=0.0, le=0.1, description="What a magnet holds round its corner [m], 0 for a point."
    )


class DatasetInputs(Strict):
    """What to sweep; as the options of ``drapemeter dataset``."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"materials": 4, "jitters": 1, "resolution_m": 0.02}]})

    materials: Whole = Field(ge=1, le=1_000_000, description="Fabrics.")
    jitters: Whole = Field(default=2, ge=1, le=1000, description="Repeats of each fabric in each scene.")
    inclinations: Whole = Field(default=11, ge=1, le=101, description="Pictures of each drape, evenly over ±5 degrees.")
    scenes: tuple[Literal["hanging", "stretch"], ...] = Field(
        default=("hanging", "stretch"), min_length=1, max_length=2
    )
    design: Literal["sobol", "random", "grid"] = Field(default="sobol", description="How fabrics are chosen.")
    resolution_m: Number = Field(default=0.01, ge=0.002, le=0.05, description="Edge of a mesh cell [m].")
    seed: Whole = Field(default=0, ge=0, le=2**31 - 1)
    sensor: Literal["ideal", "sr300"] = Field(default="ideal", description="What the depth camera adds.")
    simulator: SimulatorDocument | None = Field(
        default=None, description="Effects to simulate with, as `drapemeter diagnose --apply` writes them."
    )

    def check(self) -> None:
        """What can be known to fail before anything is simulated.

        Raises:
            InputError: for instance a resolution that does not cut the sample into whole cells, or an unknown effect.
        """
        self.plan()

    def plan(self) -> tuple[SweepConfiguration, FabricTable]:
        """The same for :mod:`services.dataset`."""
        from diagnosis.extension import AppliedEffect, SimulatorExtension
        from services.dataset.fabrics import plan_sweep

        found = SimulatorDocument(effects=()) if self.simulator is None else self.simulator
        return plan_sweep(
            design=self.design,
            materials=self.materials,
            jitters=self.jitters,
            inclinations=self.inclinations,
            scenes=self.scenes,
            resolution_m=self.resolution_m,
            seed=self.seed,
            sensor=self.sensor,
            simulator=SimulatorExtension(
                effects=tuple(AppliedEffect(name=effect.name, size=effect.size) for effect in found.effects),
                pin_radius_m=found.pin_radius_m,
            ),
        )


class _SweepProgress:
    """Reports how much of a store is done, what an earlier attempt left of it included.

    Args:
        report: where to.
        total: simulations of the store.
    """

    def __init__(self, report: Report, total: int) -> None:
        self._report, self._total, self._done = report, total, 0

    def begin(self, cost: CostEstimate) -> None:
        """The sweep starts, or goes on."""
        self._done = self._total - cost.simulations

    def hear(self, word: SimulationDone) -> None:
        """A simulation is done."""
        self._done += 1
        self._report(self._done / self._total, f"{self._done} of {self._total} simulations")


def run(task: Task, report: Report) -> TaskOutput:
    """Sweep, or go on with what an earlier attempt of this job left; what another version left is begun anew.

    Raises:
        DrapemeterError: the store's place fails.
    """
    from services.dataset.sweep import run_sweep

    configuration, fabrics = DatasetInputs.model_validate(task.inputs).plan()
    store = store_of(task.resources.dataset_root, task.job_id, configuration)
    progress = _SweepProgress(report, configuration.layout.simulations)
    summary = run_sweep(
        store,
        configuration,
        fabrics,
        resume=True,
        address=task.resources.ray_address or "local",
        listen=progress.hear,
        begin=progress.begin,
    )
    place = store if "://" in store else str(Path(store).absolute())  # whoever reads it stands in another folder
    return TaskOutput(
        {"store": place, "samples": summary.samples, "failed": summary.failed, "seconds": summary.seconds}
    )


def store_of(root: str, job_id: str, configuration: SweepConfiguration) -> str:
    """Where a job's store goes, or lies already; beside one that cannot be gone on with, as another version began it.

    Raises:
        DrapemeterError: the place fails.
    """
    begun = f"{root.rstrip('/')}/{job_id}"
    places = (f"{begun}-{number}.zarr" for number in itertools.count(2))
    return next(store for store in itertools.chain([f"{begun}.zarr"], places) if _can_go_on(store, configuration))


def _can_go_on(store: str, configuration: SweepConfiguration) -> bool:
    from services.dataset.sweep import shards_left

    try:
        shards_left(store, configuration, resume=True)
    except DrapemeterError as error:
        if error.code in OF_ANOTHER_VERSION:
            return False
        raise
    return True
