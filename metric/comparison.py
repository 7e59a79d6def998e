"""Which image distance? Each on orderings that are known beforehand."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metric.backends import Backend
from metric.drape_distance import RenderSets
from metric.matrix import PairTables, pair_tables, share_by_repeats
from metric.orderings import monotone_share
from simcore.scenes import Scene

_TRIALS = 20


@dataclass(frozen=True)
class BackendScore:
    """How one image distance did.

    Attributes:
        name: of the back end.
        self_nearest: share of ordered pairs of different fabrics with d(a, a) < d(a, b), all repeats.
        self_nearest_by_scene: the same from one scene alone.
        by_simulations: the same from only N of the repeats: N to mean and standard deviation over choices of repeats.
        monotone: sweep to share of its triples in the right order.
        monotone_by_simulations: sweep to N to mean share over choices of repeats.
        seconds: wall-clock time for all features and pairs.
        renders: renders compared.
    """

    name: str
    self_nearest: float
    self_nearest_by_scene: dict[Scene, float]
    by_simulations: dict[int, tuple[float, float]]
    monotone: dict[str, float]
    monotone_by_simulations: dict[str, dict[int, float]]
    seconds: float
    renders: int
    matrix: NDArray[np.float64] = field(repr=False, compare=False)


def score_backend(
    backend: Backend,
    fabrics: Sequence[RenderSets],
    sweeps: Mapping[str, Sequence[RenderSets]],
    *,
    seed: int = 0,
    on_done: Callable[[], None] | None = None,
) -> BackendScore:
    """Put one image distance to the tests.

    Args:
        backend: the image distance.
        fabrics: renders of different fabrics.
        sweeps: renders of the fabrics of each sweep, in order.
        seed: chooses the repeats for smaller N.
        on_done: called after each fabric and scene.

    Raises:
        InputError: too few renders.
    """
    rng = np.random.default_rng(seed)
    started = time.perf_counter()
    tables = pair_tables(fabrics, backend, on_done=on_done)
    swept = {name: pair_tables(sets, backend, on_done=on_done) for name, sets in sweeps.items()}
    seconds = time.perf_counter() - started
    matrix = tables.matrix()
    counts = range(1, tables.repeats + 1)
    return BackendScore(
        name=backend.name,
        self_nearest=matrix.self_nearest_share,
        self_nearest_by_scene={s: tables.scenes_only([s]).matrix().self_nearest_share for s in tables.tables},
        by_simulations=share_by_repeats(tables, counts, trials=_TRIALS, rng=rng),
        monotone={name: monotone_share(t.matrix().distance) for name, t in swept.items()},
        monotone_by_simulations={name: _monotone_by_repeats(t, rng) for name, t in swept.items()},
        seconds=seconds,
        renders=sum(_renders(t) for t in (tables, *swept.values())),
        matrix=matrix.distance,
    )


def _monotone_by_repeats(tables: PairTables, rng: np.random.Generator) -> dict[int, float]:
    found = {}
    for count in range(1, tables.repeats + 1):
        shares = []
        for _ in range(_TRIALS):
            chosen = np.stack([rng.permutation(tables.repeats)[:count] for _ in range(tables.fabrics)])
            shares.append(monotone_share(tables.distances(chosen)))
        found[count] = float(np.mean(shares))
    return found


def _renders(tables: PairTables) -> int:
    return tables.fabrics * tables.repeats * len(tables.tables)
