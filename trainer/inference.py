"""Run a network over many pairs of pictures and keep what later steps need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from trainer.augment import Augmenter
from trainer.config import AugmentConfig, NetworkConfig
from trainer.dataset import SCENES, PairStream, PictureSource, PictureTable, batches
from trainer.network import DrapeNetwork, Features, Prediction, fuse
from trainer.outliers import picture_statistics
from trainer.preprocess import network_images
from trainer.targets import TargetScaling

SCENE_SETS: tuple[tuple[int, ...], ...] = ((0,), (1,), (0, 1))
"""Every non-empty set of scenes, as indices into ``trainer.dataset.SCENES``."""


def scene_names(scene_set: tuple[int, ...]) -> tuple[str, ...]:
    """Names of a set of scenes."""
    return tuple(SCENES[index].value for index in scene_set)


@dataclass(frozen=True)
class PairFeatures:
    """Features of pairs; absent pictures have zeros.

    Attributes:
        maximum, mean: float32 tensors, shape [pairs, scenes, channels].
        statistics: float64, shape [pairs, scenes, 9].
        present: bool tensor, shape [pairs, scenes].
        parameters: the seven, SI, float64, shape [pairs, 7].
        material: int64, shape [pairs].
    """

    maximum: Tensor
    mean: Tensor
    statistics: NDArray[np.float64]
    present: Tensor
    parameters: NDArray[np.float64]
    material: NDArray[np.int64]

    def of_scene(self, scene: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pooled features [n, 2 * channels] and statistics [n, 9] of the pictures of one scene."""
        rows = self.present[:, scene]
        joined = torch.cat([self.maximum[rows, scene], self.mean[rows, scene]], dim=1)
        return np.asarray(joined.numpy(), dtype=np.float64), self.statistics[rows.numpy(), scene]


@dataclass(frozen=True)
class SubsetPrediction:
    """Predictions from one set of scenes; arrays have one row a pair that shows all of them.

    Attributes:
        mean, spread: standardised targets, float64, shape [n, 6].
        parameters: truth, SI, shape [n, 7].
        material: int64, shape [n].
    """

    mean: NDArray[np.float64]
    spread: NDArray[np.float64]
    parameters: NDArray[np.float64]
    material: NDArray[np.int64]


@torch.no_grad()
def extract_pairs(
    network: DrapeNetwork,
    source: PictureSource,
    table: PictureTable,
    *,
    augment: AugmentConfig = AugmentConfig.off(),
    seed: int = 0,
    batch_pairs: int = 16,
) -> PairFeatures:
    """Features of every picture of a table, paired across scenes in the order of the store."""
    config: NetworkConfig = network.config
    augmenter = Augmenter(augment)
    stream = PairStream(source, table, size=config.input_size, passes=1, shuffled=False, cache_bytes=0)
    columns: list[PairFeatures] = []
    for number, batch in enumerate(batches(stream, batch_pairs)):
        flat = augmenter(batch.pictures[batch.present], seed + number)
        maximum, mean = network.extract_by_scene(network_images(flat, config), batch.present)
        statistics = np.zeros((*batch.present.shape, 9))
        statistics[batch.present.numpy()] = picture_statistics(flat)
        columns.append(
            PairFeatures(maximum, mean, statistics, batch.present, batch.parameters.numpy(), batch.material.numpy())
        )
    return PairFeatures(
        torch.cat([c.maximum for c in columns]),
        torch.cat([c.mean for c in columns]),
        np.concatenate([c.statistics for c in columns]),
        torch.cat([c.present for c in columns]),
        np.concatenate([c.parameters for c in columns]),
        np.concatenate([c.material for c in columns]),
    )


@torch.no_grad()
def predict_subset(
    network: DrapeNetwork, pairs: PairFeatures, scene_set: tuple[int, ...], scaling: TargetScaling
) -> SubsetPrediction:
    """Predict from a set of scenes, on the pairs that show all of them."""
    rows = pairs.present[:, list(scene_set)].all(dim=1)
    shown = torch.zeros_like(pairs.present[rows])
    shown[:, list(scene_set)] = True
    keep = rows.numpy()
    density = torch.from_numpy(scaling.encode_density(pairs.parameters[keep, 6])).float()
    fused = fuse(Features(pairs.maximum[rows], pairs.mean[rows]), shown)
    prediction: Prediction = network.regress(fused, density)
    return SubsetPrediction(
        prediction.mean.double().numpy(),
        prediction.log_spread.exp().double().numpy(),
        pairs.parameters[keep],
        pairs.material[keep],
    )
