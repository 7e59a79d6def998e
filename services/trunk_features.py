"""The estimator's own trunk as an image distance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from metric.feature_distance import FeatureDistance
    from metric.render import DrapeRender


def trunk_distance(model: Path | None) -> FeatureDistance:
    """Distance between the pooled features that the estimator regresses from.

    Args:
        model: folder of the trained estimator; None for the one that ships.

    Raises:
        InputError, MissingResourceError: no such model.
    """
    import torch

    from metric.feature_distance import FeatureDistance as NewDistance
    from trainer.predict import Estimator
    from trainer.preprocess import network_images, resize

    estimator = Estimator.load(model)
    network, settings = estimator.model.network, estimator.model.config.network

    def extract(renders: Sequence[DrapeRender]) -> list[NDArray[np.float32]]:
        found: list[NDArray[np.float32]] = []
        with torch.inference_mode():
            for start in range(0, len(renders), 16):
                heights = np.stack([r.height for r in renders[start : start + 16]])
                pictures = resize(torch.from_numpy(heights)[:, None], settings.input_size)
                features = network.extract(network_images(pictures, settings))
                found.extend(torch.cat(list(features), dim=1).numpy())
        return found

    return NewDistance("trunk", extract, estimator.version)
