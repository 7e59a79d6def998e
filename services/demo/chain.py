"""The demonstration from its first to its last step."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from services.dataset.sweep import SweepSummary
from services.demo import captures, drapes, fabrics, gap, learning
from services.demo.plan import DemoPlan
from services.demo.steps import StepClock, prepare_folder
from simcore.cores import usable_cores
from simcore.scenes import Scene
from trainer.model import TrainedModel

STEPS = 7


@dataclass(frozen=True)
class DemoResult:
    """What the demonstration found; the pictures lie in its folder.

    Attributes:
        samples, failed: rows of the store, and how many of them failed.
        estimates: each parameter of each named fabric beside its truth.
        error, error_of_mean: mean absolute error of the logarithm on held-out materials, of the network and of
            predicting the training mean.
        distances: between the named fabrics.
        gap: what the diagnosis said of captures in a draft.
        seconds: of each step.
    """

    samples: int
    failed: int
    estimates: list[learning.EstimateRow]
    error: float
    error_of_mean: float
    distances: drapes.DistanceMatrix
    gap: gap.GapSummary
    seconds: dict[str, float]


def run_chain(out: Path, plan: DemoPlan) -> DemoResult:
    """Run every step into a folder.

    Raises:
        InputError: the folder holds something else.
        DrapemeterError: a step failed; what the steps before it made stays.
    """
    prepare_folder(out)
    clock = StepClock(STEPS)
    _one_fabric(out, plan, clock)
    _sweeps(out, plan, clock)
    summary = _store(out, plan, clock)
    model = _training(out, plan, clock)
    estimates = _estimates(out, plan, clock)
    distances = _distances(out, plan, clock)
    found = _diagnosis(out, plan, clock)
    error, error_of_mean = errors(model)
    return DemoResult(
        samples=summary.samples,
        failed=sum(summary.failed.values()),
        estimates=estimates,
        error=error,
        error_of_mean=error_of_mean,
        distances=distances,
        gap=found,
        seconds=clock.seconds,
    )


def _one_fabric(out: Path, plan: DemoPlan, clock: StepClock) -> None:
    with clock.step("simulate and render one fabric in both scenes"):
        drapes.one_drape(out, plan.fine_m, plan.seed)


def _sweeps(out: Path, plan: DemoPlan, clock: StepClock) -> None:
    with clock.step("sweep bending and stretch stiffness", 4 * len(fabrics.BENDING_SWEEP)) as bar:
        drapes.sweeps(out / "sweep.png", plan.fine_m, plan.seed, bar.advance)


def _store(out: Path, plan: DemoPlan, clock: StepClock) -> SweepSummary:
    with clock.step("make a store of fabrics on Ray", 2 * plan.materials) as bar:
        return learning.make_store(
            out / "store.zarr",
            materials=plan.materials,
            resolution_m=plan.coarse_m,
            seed=plan.seed,
            on_done=bar.advance,
        )


def _training(out: Path, plan: DemoPlan, clock: StepClock) -> TrainedModel:
    with clock.step("train an estimator on it") as bar:
        return learning.learn(
            out / "store.zarr",
            out / "model",
            epochs=plan.epochs,
            seed=plan.seed,
            on_step=lambda step, total: bar.update(completed=step, total=total),
        )


def _estimates(out: Path, plan: DemoPlan, clock: StepClock) -> list[learning.EstimateRow]:
    with clock.step("estimate fabrics that were not in it", 2 * len(fabrics.NAMED)) as bar:
        captures.simulate_captures(
            out / "captures",
            fabrics.NAMED,
            repeats=1,
            resolution_m=plan.coarse_m,
            seed=plan.seed + 1,
            on_done=bar.advance,
        )
        return learning.estimate(out / "model", out / "captures")


def _distances(out: Path, plan: DemoPlan, clock: StepClock) -> drapes.DistanceMatrix:
    with clock.step("drape distances", 2 * plan.simulations * len(fabrics.NAMED)) as bar:
        return drapes.distances(out / "distances.png", plan.coarse_m, plan.simulations, plan.seed, bar.advance)


def _diagnosis(out: Path, plan: DemoPlan, clock: StepClock) -> gap.GapSummary:
    with clock.step("diagnose captures taken in a draft", 2 * plan.repeats * len(gap.FABRICS)) as bar:
        gap.drafty_captures(
            out / "drafty",
            repeats=plan.repeats,
            resolution_m=plan.coarse_m,
            seed=plan.seed + 2,
            on_done=bar.advance,
        )
        return gap.explain(
            out / "drafty",
            out / "atlas",
            out / "report",
            resolution_m=plan.coarse_m,
            workers=min(usable_cores(), len(gap.FABRICS)),
        )


def errors(model: TrainedModel) -> tuple[float, float]:
    """Mean absolute error of the logarithm over the six parameters, of both scenes together and of the mean."""
    both = "+".join(scene.value for scene in Scene)
    return model.metrics.average(both, "mae_log"), model.metrics.average("mean", "mae_log")
