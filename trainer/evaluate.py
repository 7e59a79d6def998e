"""How good a network is on held-out materials, as in the paper's tables, beside what needs no picture."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from simcore.parameters import ESTIMATED_NAMES
from trainer.dataset import PictureSource, PictureTable
from trainer.inference import SCENE_SETS, extract_pairs, predict_subset, scene_names
from trainer.intervals import IntervalTable, scene_key
from trainer.network import DrapeNetwork
from trainer.split import MaterialSplit
from trainer.targets import TargetScaling

FloatArray = NDArray[np.float64]
LEAST_RANKED = 3
"""Different fabrics whose order tells anything."""

MEAN, DENSITY = "mean", "density"
"""Names of the two predictors without pictures: the training mean, and a regression on the density alone."""


@dataclass(frozen=True)
class Score:
    """One predictor on one parameter.

    Attributes:
        mae_log: mean absolute error of the natural logarithm; exp of it is a typical factor.
        mae_range: mean absolute error over the range of the training materials, as in the paper's tables; NaN where
            they are all alike.
        spearman: rank correlation with the truth; 0 for a constant prediction, NaN where fewer than
            :data:`LEAST_RANKED` fabrics were tested.
        coverage: share of truths inside the 90 % interval; NaN without intervals.
        interval_factor: typical upper over lower end of the interval; NaN without intervals.
    """

    mae_log: float
    mae_range: float
    spearman: float
    coverage: float = math.nan
    interval_factor: float = math.nan

    def to_json(self) -> dict[str, float | None]:
        """As plain JSON values; NaN is null."""
        return {name: None if math.isnan(value) else value for name, value in asdict(self).items()}


@dataclass(frozen=True)
class Metrics:
    """Scores on the test materials.

    Attributes:
        scores: predictor (``mean``, ``density``, or a set of scenes) -> parameter -> score.
        materials: numbers of materials learnt from, calibrated on and tested on.
        pictures: pictures tested on.
    """

    scores: dict[str, dict[str, Score]]
    materials: dict[str, int]
    pictures: int

    def average(self, predictor: str, quantity: str, prefix: str = "") -> float:
        """Mean of a quantity over the parameters whose name starts with ``prefix``."""
        values = [getattr(s, quantity) for n, s in self.scores[predictor].items() if n.startswith(prefix)]
        return float(np.mean(values))

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values; NaN is null."""
        scores = {
            predictor: {name: score.to_json() for name, score in rows.items()}
            for predictor, rows in self.scores.items()
        }
        return {"scores": scores, "materials": dict(self.materials), "pictures": self.pictures}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Metrics:
        """Back from :meth:`to_json`."""
        scores = {
            predictor: {
                name: Score(**{k: math.nan if v is None else v for k, v in score.items()})
                for name, score in rows.items()
            }
            for predictor, rows in values["scores"].items()
        }
        return cls(scores, dict(values["materials"]), values["pictures"])

    def table(self) -> str:
        """Markdown: a row a parameter, a pair of columns (typical factor, Spearman) a predictor."""
        predictors = list(self.scores)
        lines = ["| parameter | " + " | ".join(f"{p}: factor | r" for p in predictors) + " |"]
        lines.append("|---" * (1 + 2 * len(predictors)) + "|")
        for name in ESTIMATED_NAMES:
            cells = [
                f"{math.exp(self.scores[p][name].mae_log):.2f} | {number_text(self.scores[p][name].spearman)}"
                for p in predictors
            ]
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        return "\n".join(lines)


def evaluate(
    network: DrapeNetwork,
    source: PictureSource,
    table: PictureTable,
    split: MaterialSplit,
    scaling: TargetScaling,
    intervals: IntervalTable,
) -> Metrics:
    """Test a network on the test materials, from each set of scenes, beside the predictors without pictures."""
    training = table.of_materials(split.train).material_parameters()
    test = table.of_materials(split.test)
    pairs = extract_pairs(network, source, test)
    scores = {
        MEAN: _scores(training, pairs.parameters, _constant(training, len(pairs.parameters))),
        DENSITY: _scores(training, pairs.parameters, _density_regression(training, pairs.parameters[:, 6])),
    }
    for scene_set in SCENE_SETS:
        found = predict_subset(network, pairs, scene_set, scaling)
        if not len(found.material):
            continue
        names = scene_names(scene_set)
        half = intervals.half_widths(names, found.spread)
        logs = scaling.decode(found.mean, found.parameters[:, 6])
        scores[scene_key(names)] = _scores(training, found.parameters, logs, half * np.asarray(scaling.spread))
    counts = {"train": len(split.train), "calibration": len(split.calibration), "test": len(split.test)}
    return Metrics(scores, counts, int(pairs.present.sum()))


def _scores(
    training: FloatArray, truth: FloatArray, predicted_logs: FloatArray, half_widths: FloatArray | None = None
) -> dict[str, Score]:
    logs = np.log(truth[:, :6])
    spans = np.ptp(training[:, :6], axis=0)
    spans[spans == 0.0] = math.nan
    result = {}
    for k, name in enumerate(ESTIMATED_NAMES):
        error = np.abs(predicted_logs[:, k] - logs[:, k])
        linear = np.abs(np.exp(predicted_logs[:, k]) - truth[:, k]) / spans[k]
        score = Score(float(error.mean()), float(linear.mean()), rank_correlation(predicted_logs[:, k], logs[:, k]))
        if half_widths is not None and np.isfinite(half_widths[:, k]).all():
            coverage = float((error <= half_widths[:, k]).mean())
            factor = float(np.exp(2 * np.median(half_widths[:, k])))
            score = Score(score.mae_log, score.mae_range, score.spearman, coverage, factor)
        result[name] = score
    return result


def rank_correlation(predicted: FloatArray, truth: FloatArray) -> float:
    """Spearman's of predictions and truth; 0 for constant predictions, NaN for too few truths to be in an order."""
    if len(np.unique(truth)) < LEAST_RANKED:
        return math.nan
    if np.ptp(predicted) < 1e-12:
        return 0.0
    return float(spearmanr(predicted, truth).statistic)


def number_text(value: float, digits: int = 2) -> str:
    """For tables; a dash for what is not known."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _constant(training: FloatArray, count: int) -> FloatArray:
    return np.tile(np.log(training[:, :6]).mean(axis=0), (count, 1))


def _density_regression(training: FloatArray, density: FloatArray) -> FloatArray:
    """Least squares of the log-parameters on ln density and its square."""

    def design(values: FloatArray) -> FloatArray:
        log = np.log(values)
        return np.stack([np.ones_like(log), log, log**2], axis=1)

    solution, *_ = np.linalg.lstsq(design(training[:, 6]), np.log(training[:, :6]), rcond=None)
    return np.asarray(design(density) @ solution)
