"""The drape distance: mean image distance over all pairs of renders, then over scenes (paper, section 5)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metric.backends import Backend
from metric.feature_cache import FeatureCache
from metric.render import DrapeRender
from metric.uncertainty import mean_and_error, self_mean_and_error
from simcore.errors import InputError
from simcore.scenes import Scene

RenderSets = Mapping[Scene, Sequence[DrapeRender]]
"""Renders of one fabric: several simulations in each scene."""


@dataclass(frozen=True)
class DrapeDistance:
    """d(a, b) of two fabrics.

    Attributes:
        distance: mean over scenes, in ``unit``.
        standard_error: of ``distance``, from the scatter between simulations; None with one simulation a scene.
        scenes: d of each scene.
        scene_errors: standard error of each.
        tables: IM of every pair of renders, float64, shape [N, M], by scene.
        simulations: renders a scene and fabric (the fewer of the two).
        backend: name of the image distance.
        unit: unit of the distance, "" where it has none.
    """

    distance: float
    standard_error: float | None
    scenes: dict[Scene, float]
    scene_errors: dict[Scene, float | None]
    tables: dict[Scene, NDArray[np.float64]]
    simulations: int
    backend: str
    unit: str


def drape_distance(
    renders_a: RenderSets,
    renders_b: RenderSets | None,
    backend: Backend,
    *,
    cache: FeatureCache | None = None,
) -> DrapeDistance:
    """Drape distance between two fabrics from renders of their simulations.

    Features are computed once a render (2N passes a scene), the N² image distances come from those.

    Args:
        renders_a: renders of the one fabric by scene.
        renders_b: of the other, same scenes; None for the distance of ``renders_a`` from itself, the mean over pairs
            of different renders.
        backend: the image distance.
        cache: keeps features by content between calls.

    Raises:
        InputError: no renders, other scenes on either side, or pictures that cannot be compared.
    """
    cache = cache if cache is not None else FeatureCache()
    _check_sets(renders_a, renders_b)
    tables: dict[Scene, NDArray[np.float64]] = {}
    estimates: dict[Scene, tuple[float, float | None]] = {}
    for scene in sorted(renders_a):
        if renders_b is None:
            features = cache.features(backend, renders_a[scene])
            tables[scene] = backend.table(features, features)
            estimates[scene] = self_mean_and_error(tables[scene])
        else:
            features = cache.features(backend, [*renders_a[scene], *renders_b[scene]])
            count = len(renders_a[scene])
            tables[scene] = backend.table(features[:count], features[count:])
            estimates[scene] = mean_and_error(tables[scene])
    errors = [error for _, error in estimates.values()]
    known = [e for e in errors if e is not None]
    return DrapeDistance(
        distance=float(np.mean([mean for mean, _ in estimates.values()])),
        standard_error=math.sqrt(sum(e * e for e in known)) / len(known) if len(known) == len(errors) else None,
        scenes={scene: mean for scene, (mean, _) in estimates.items()},
        scene_errors={scene: error for scene, (_, error) in estimates.items()},
        tables=tables,
        simulations=min(min(t.shape) for t in tables.values()),
        backend=backend.name,
        unit=backend.unit,
    )


def _check_sets(a: RenderSets, b: RenderSets | None) -> None:
    least = 2 if b is None else 1
    for renders in (a, *([] if b is None else [b])):
        if not renders or any(len(r) < least for r in renders.values()):
            raise InputError(
                f"the drape distance needs at least {least} render(s) of each fabric in each scene: simulate more",
                code="renders_too_few",
            )
    if b is not None and set(a) != set(b):
        raise InputError(
            f"the two fabrics were rendered in different scenes ({', '.join(sorted(a))} and {', '.join(sorted(b))})",
            code="scenes_differ",
        )
