"""The model that ships: what `estimate`, the service and the diagnosis take where no other is named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from simcore.parameters import ESTIMATED_NAMES
from trainer.evaluate_captures import known_fabrics
from trainer.predict import Estimator
from trainer.shipped import DEFAULT_MODEL


def test_it_is_whole_and_knows_both_scenes() -> None:
    estimator = Estimator.load()
    stated = json.loads((DEFAULT_MODEL / "model.json").read_text(encoding="utf-8"))
    assert estimator.version == stated["model_version"]
    assert set(estimator.model.outliers) == {"hanging", "stretch"}
    for scenes in (["hanging"], ["stretch"], ["hanging", "stretch"]):
        assert estimator.model.intervals.promises(scenes)


def test_it_estimates_fabrics_of_another_simulator(shared_dir: Path) -> None:
    """The first open set has no effect in it."""
    estimator = Estimator.load()
    factors, inside = [], []
    for fabric in known_fabrics([shared_dir / "cases" / "open-1"]):
        found = estimator.estimate(fabric.inputs, fabric.density)
        estimated = np.array([found.parameters[name] for name in ESTIMATED_NAMES])
        ends = np.array([found.intervals_90[name] for name in ESTIMATED_NAMES])
        assert (ends[:, 0] < estimated).all() and (estimated < ends[:, 1]).all() and found.intervals_calibrated
        factors.append(np.exp(np.abs(np.log(estimated / fabric.parameters))))
        inside.append((ends[:, 0] <= fabric.parameters) & (fabric.parameters <= ends[:, 1]))
    assert np.median(factors) < 1.6  # unit mistakes, swapped outputs and a wrong height are far beyond
    assert np.mean(inside) > 0.6
