"""Steps that learn: a small store made on Ray, a short training run, estimates of fabrics that were not in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from capture.capture_set import CaptureSet
from capture.prepare import inputs_by_fabric, prepare_all
from services.dataset.fabrics import plan_sweep
from services.dataset.sweep import SweepSummary, run_sweep
from services.demo import fabrics
from simcore.parameters import ESTIMATED_NAMES
from trainer.model import TrainedModel
from trainer.predict import Estimator
from trainer.presets import preset_config
from trainer.store_source import StoreSource
from trainer.train import train


@dataclass(frozen=True)
class EstimateRow:
    """One parameter of one fabric: the truth beside what the pictures told.

    Attributes:
        fabric: its name.
        parameter: which.
        truth: value that the captures were simulated with, SI.
        estimate: value from the network, SI.
        low, high: 90 % interval, SI.
    """

    fabric: str
    parameter: str
    truth: float
    estimate: float
    low: float
    high: float


def make_store(
    url: Path, *, materials: int, resolution_m: float, seed: int, on_done: Callable[[], None] | None = None
) -> SweepSummary:
    """Sweep fabrics of the prior through both scenes into a store, by Ray tasks on this machine."""
    configuration, table = plan_sweep(
        materials=materials, jitters=1, inclinations=3, resolution_m=resolution_m, seed=seed
    )
    return run_sweep(url, configuration, table, listen=lambda word: on_done() if on_done is not None else None)


def learn(
    store: Path, model: Path, *, epochs: int, seed: int, on_step: Callable[[int, int], None] | None = None
) -> TrainedModel:
    """Train a small network on the store and save it."""
    config = replace(preset_config("quick"), epochs=epochs, seed=seed)
    source = StoreSource(store)
    trained = train(
        source,
        config,
        provenance=source.provenance(),
        report=None if on_step is None else lambda progress: on_step(progress.step, progress.steps),
    )
    trained.save(model)
    return trained


def estimate(model: Path, captures: Path) -> list[EstimateRow]:
    """Estimate the fabrics of a capture set that :func:`~services.demo.captures.simulate_captures` made."""
    capture_set = CaptureSet.load(captures)
    estimator = Estimator.load(model)
    inputs = inputs_by_fabric(prepare_all(capture_set.captures))
    rows = []
    for name in capture_set.fabrics:
        truth = fabrics.NAMED[name].as_dict()
        found = estimator.estimate(inputs[name], truth["density"])
        for parameter in ESTIMATED_NAMES:
            low, high = found.intervals_90[parameter]
            rows.append(EstimateRow(name, parameter, truth[parameter], found.parameters[parameter], low, high))
    return rows
