"""Drape distances between all fabrics of a set, and what they say about an image distance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metric.backends import Backend
from metric.drape_distance import RenderSets
from metric.feature_cache import FeatureCache
from metric.uncertainty import means_and_errors, self_mean_and_error
from simcore.errors import InputError
from simcore.scenes import Scene


@dataclass(frozen=True)
class DistanceMatrix:
    """Drape distances of n fabrics.

    Attributes:
        distance: d(a, b), float64, shape [n, n]; the diagonal holds d(a, a), the mean over different repeats.
        standard_error: of each, float64, shape [n, n]; NaN where there are too few repeats.
    """

    distance: NDArray[np.float64]
    standard_error: NDArray[np.float64]

    @property
    def self_is_nearest(self) -> NDArray[np.bool_]:
        """The paper's minimum requirement d(a, a) < d(a, b), bool, shape [n, n]; True on the diagonal."""
        holds: NDArray[np.bool_] = np.diag(self.distance)[:, None] < self.distance
        np.fill_diagonal(holds, True)
        return holds

    @property
    def self_nearest_share(self) -> float:
        """Share of ordered pairs a != b that satisfy d(a, a) < d(a, b)."""
        count = len(self.distance)
        return float((self.self_is_nearest.sum() - count) / (count * (count - 1)))


@dataclass(frozen=True)
class PairTables:
    """IM between all renders of all fabrics.

    Attributes:
        tables: by scene, float64, shape [n, N, n, N]: fabric, repeat, fabric, repeat.
    """

    tables: dict[Scene, NDArray[np.float64]]

    @property
    def fabrics(self) -> int:
        """Number of fabrics n."""
        return int(next(iter(self.tables.values())).shape[0])

    @property
    def repeats(self) -> int:
        """Simulations of each fabric in each scene N."""
        return int(next(iter(self.tables.values())).shape[1])

    def scenes_only(self, scenes: Sequence[Scene]) -> PairTables:
        """The same with some scenes only."""
        return PairTables({scene: self.tables[scene] for scene in scenes})

    def distances(self, chosen: NDArray[np.int64] | None = None) -> NDArray[np.float64]:
        """Distances from all repeats or from some.

        Args:
            chosen: repeats to use of each fabric, shape [n, M]; all by default.

        Returns:
            float64, shape [n, n]; the diagonal is the mean over different repeats, NaN where M is 1.
        """
        if chosen is None:
            chosen = np.tile(np.arange(self.repeats), (self.fabrics, 1))
        count, used = chosen.shape
        flat = (np.arange(count)[:, None] * self.repeats + chosen).ravel()
        place = np.arange(count)
        total = np.zeros((count, count))
        for table in self.tables.values():
            part = table.reshape(count * self.repeats, -1)[np.ix_(flat, flat)].reshape(count, used, count, used)
            means = part.mean(axis=(1, 3))
            own = np.einsum("aiai->a", part)
            means[place, place] = (means[place, place] * used**2 - own) / (used * (used - 1)) if used > 1 else np.nan
            total += means
        return total / len(self.tables)

    def matrix(self) -> DistanceMatrix:
        """Distances and their standard errors from all repeats.

        Raises:
            InputError: fewer than two repeats, which leave no d(a, a).
        """
        if self.repeats < 2:
            raise InputError("d(a, a) needs at least two simulations of each fabric", code="renders_too_few")
        count = self.fabrics
        variance = np.zeros((count, count))
        for table in self.tables.values():
            pairs = table.transpose(0, 2, 1, 3).reshape(count * count, self.repeats, self.repeats)
            errors = means_and_errors(pairs)[1].reshape(count, count)
            own = [self_mean_and_error(table[a, :, a, :])[1] for a in range(count)]
            errors[np.arange(count), np.arange(count)] = [np.nan if e is None else e for e in own]
            variance += errors**2
        return DistanceMatrix(self.distances(), np.sqrt(variance) / len(self.tables))


def pair_tables(
    fabrics: Sequence[RenderSets],
    backend: Backend,
    *,
    cache: FeatureCache | None = None,
    on_done: Callable[[], None] | None = None,
) -> PairTables:
    """IM between all renders of all fabrics; every render passes through the back end once.

    Holds the features of one scene in memory (LPIPS: about 4.4 MB a render of 256 x 256).

    Args:
        fabrics: renders of each fabric by scene, equally many everywhere.
        backend: the image distance.
        cache: keeps features by content between calls.
        on_done: called after each fabric and scene.

    Raises:
        InputError: fewer than two fabrics, or not equally many renders.
    """
    if len(fabrics) < 2:
        raise InputError("a distance matrix needs at least two fabrics", code="fabrics_too_few")
    counts = {len(renders) for sets in fabrics for renders in sets.values()}
    if len(counts) != 1 or len({frozenset(sets) for sets in fabrics}) != 1:
        raise InputError("every fabric needs equally many renders in the same scenes", code="renders_uneven")
    repeats = counts.pop()
    cache = cache if cache is not None else FeatureCache(memory_bytes=0)
    tables: dict[Scene, NDArray[np.float64]] = {}
    for scene in sorted(fabrics[0]):
        features = []
        for sets in fabrics:
            features.extend(cache.features(backend, sets[scene]))
            if on_done is not None:
                on_done()
        table = backend.table(features, features)
        tables[scene] = table.reshape(len(fabrics), repeats, len(fabrics), repeats)
    return PairTables(tables)


def share_by_repeats(
    tables: PairTables, counts: Sequence[int], *, trials: int, rng: np.random.Generator
) -> dict[int, tuple[float, float]]:
    """How often d(a, a) < d(a, b) when only some of the repeats had been simulated.

    Args:
        tables: IM between all renders.
        counts: numbers of repeats N to try. For N = 1 the one repeat's distance to another repeat stands for d(a, a).
        trials: random choices of repeats for each N.
        rng: chooses them.

    Returns:
        N to mean and standard deviation of the share over trials.
    """
    found: dict[int, tuple[float, float]] = {}
    for count in counts:
        shares = [_share_of_a_choice(tables, count, rng) for _ in range(trials)]
        found[count] = (float(np.mean(shares)), float(np.std(shares)))
    return found


def _share_of_a_choice(tables: PairTables, count: int, rng: np.random.Generator) -> float:
    chosen = np.stack([rng.permutation(tables.repeats)[: max(count, 2)] for _ in range(tables.fabrics)])
    distance = tables.distances(chosen)
    if count == 1:
        own = np.diag(distance).copy()
        distance = tables.distances(chosen[:, :1])
        np.fill_diagonal(distance, own)
    return DistanceMatrix(distance, distance).self_nearest_share
