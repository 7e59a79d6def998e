"""After training: interval factors and the outlier reference, from materials that were not learnt from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trainer.config import TrainConfig
from trainer.dataset import SCENES, PictureSource, PictureTable
from trainer.inference import SCENE_SETS, PairFeatures, extract_pairs, predict_subset, scene_names
from trainer.intervals import IntervalTable, conformal_factors, scene_key
from trainer.network import DrapeNetwork
from trainer.outliers import OutlierModel
from trainer.split import MaterialSplit
from trainer.targets import TargetScaling

REFERENCE_PICTURES = 1200
"""Training pictures that the outlier reference looks at, at most."""


@dataclass(frozen=True)
class Calibration:
    """Intervals by scene set and outlier references by scene name."""

    intervals: IntervalTable
    outliers: dict[str, OutlierModel]


def calibrate(
    network: DrapeNetwork,
    source: PictureSource,
    table: PictureTable,
    split: MaterialSplit,
    config: TrainConfig,
    scaling: TargetScaling,
) -> Calibration:
    """Calibrate a finished network.

    Intervals see clean pictures of the calibration materials; the outlier borders see them clean and augmented, so that
    ordinary sensor noise is no outlier.
    """
    held_out = table.of_materials(split.calibration)
    clean = extract_pairs(network, source, held_out)
    noisy = extract_pairs(network, source, held_out, augment=config.augment, seed=config.seed)
    reference = extract_pairs(
        network, source, _thinned(table.of_materials(split.train)), augment=config.augment, seed=config.seed + 1
    )
    return Calibration(_intervals(network, clean, scaling), _outliers(reference, clean, noisy))


def _intervals(network: DrapeNetwork, pairs: PairFeatures, scaling: TargetScaling) -> IntervalTable:
    factors, materials = {}, {}
    for scene_set in SCENE_SETS:
        found = predict_subset(network, pairs, scene_set, scaling)
        key = scene_key(scene_names(scene_set))
        truth = scaling.encode(found.parameters)
        factors[key] = conformal_factors(truth - found.mean, found.spread, found.material)
        materials[key] = len(np.unique(found.material))
    return IntervalTable(factors, materials)


def _outliers(reference: PairFeatures, clean: PairFeatures, noisy: PairFeatures) -> dict[str, OutlierModel]:
    models = {}
    for index, scene in enumerate(SCENES):
        features, statistics = reference.of_scene(index)
        held_out = [pairs.of_scene(index) for pairs in (clean, noisy)]
        held_out_features = np.concatenate([h[0] for h in held_out])
        if not len(features) or not len(held_out_features):
            continue
        held_out_statistics = np.concatenate([h[1] for h in held_out])
        model = OutlierModel.fit(features, statistics, held_out_features, held_out_statistics)
        models[scene.value] = model.stored()
    return models


def _thinned(table: PictureTable) -> PictureTable:
    """Not too many pictures, as many of either scene where there are; drawn at random, since rows come in an order."""
    generator = np.random.default_rng(0)
    of_scenes = [np.flatnonzero(table.scene == scene) for scene in range(len(SCENES))]
    most = REFERENCE_PICTURES // max(1, sum(len(rows) > 0 for rows in of_scenes))
    chosen = [generator.permutation(rows)[:most] for rows in of_scenes]
    return table.take(np.sort(np.concatenate(chosen)))
