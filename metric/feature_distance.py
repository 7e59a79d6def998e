"""Distance between features of any network: the estimator's own trunk, for one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from metric.backends import Channel
from metric.euclidean import squared_distance_table
from metric.render import DrapeRender
from simcore.errors import InputError

Extractor = Callable[[Sequence[DrapeRender]], Sequence[NDArray[np.float32]]]
"""Renders to feature vectors, float32, shape [D] each."""


class FeatureDistance:
    """Euclidean distance between feature vectors of unit length.

    Args:
        name: for reports.
        extract: the network.
        fingerprint: changes with the network's weights.
        channel: which picture it reads.
    """

    unit = ""

    def __init__(self, name: str, extract: Extractor, fingerprint: str, channel: Channel = Channel.DEPTH) -> None:
        self.name = name
        self.channel = channel
        self.fingerprint = f"features/1/{fingerprint}"
        self._extract = extract

    def features(self, renders: Sequence[DrapeRender]) -> list[NDArray[np.float32]]:
        """Unit vectors, float32, shape [D]."""
        found = []
        for vector in self._extract(renders):
            length = float(np.linalg.norm(vector))
            if not np.isfinite(length) or length == 0.0:
                raise InputError(f"{self.name}: the network gave no usable features", code="features_not_finite")
            found.append((np.asarray(vector, np.float32) / length).ravel())
        return found

    def table(self, a: Sequence[NDArray[np.float32]], b: Sequence[NDArray[np.float32]]) -> NDArray[np.float64]:
        """Euclidean distance of every pair, shape [len(a), len(b)]."""
        table: NDArray[np.float64] = np.sqrt(squared_distance_table(a, b))
        return table
