"""Search by drape: order a library by distance from a reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metric.backends import Backend, SquaredEuclideanBackend
from metric.descriptor import DescriptorStore, FabricDescriptor, describe, descriptor_key, thumbnail
from metric.drape_distance import drape_distance
from metric.feature_cache import FeatureCache
from metric.index import FabricIndex
from metric.library import LibraryFabric
from metric.render import DrapeRender
from metric.render_cache import RenderCache
from metric.simulate import Runner, SimulationPlan, simulate_fabrics
from metric.sketch import Sketched
from simcore.errors import SimulationError
from simcore.parameters import FabricParameters
from simcore.scenes import Scene

EXACT_UP_TO = 20
"""Libraries of at most so many fabrics are compared with full features; larger ones by sketches (within about 1 %)."""

_FABRICS_AT_A_TIME = 32  # renders of more are not held in memory at once


@dataclass(frozen=True)
class RankedFabric:
    """One place of a ranking.

    Attributes:
        id: of the library's fabric.
        distance: drape distance from the reference, in the back end's unit.
        standard_error: of the distance; None with one simulation a scene.
        pictures: by scene, a small shaded picture of the fabric's drape, uint8, shape [H, W].
    """

    id: str
    distance: float
    standard_error: float | None
    pictures: dict[Scene, NDArray[np.uint8]] = field(default_factory=dict, repr=False, compare=False)


@dataclass(frozen=True)
class FailedFabric:
    """A fabric of the library that could not be ranked.

    Attributes:
        id: of the library's fabric.
        reason: why its simulations did not come to rest.
    """

    id: str
    reason: str


@dataclass(frozen=True)
class SearchResult:
    """A library in the order of its likeness to a reference.

    Attributes:
        ranking: the nearest first; ties keep the library's order.
        reference_pictures: as :attr:`RankedFabric.pictures`, of the reference.
        failed: fabrics that could not be simulated and so have no place.
    """

    ranking: list[RankedFabric]
    reference_pictures: dict[Scene, NDArray[np.uint8]] = field(repr=False, compare=False)
    failed: list[FailedFabric] = field(default_factory=list)


def search_library(
    reference: FabricParameters,
    library: Sequence[LibraryFabric],
    backend: Backend,
    plan: SimulationPlan,
    *,
    runner: Runner | None = None,
    renders: RenderCache | None = None,
    features: FeatureCache | None = None,
    descriptors: DescriptorStore | None = None,
    exact: bool | None = None,
    on_done: Callable[[], None] | None = None,
) -> SearchResult:
    """Library fabrics by drape distance from a reference.

    Args:
        reference: what to look for.
        library: where to look.
        backend: the image distance.
        plan: how to simulate.
        runner, renders, on_done: as for :func:`metric.simulate.simulate_fabrics`.
        features: as for :func:`metric.drape_distance.drape_distance`.
        descriptors: keeps what large libraries are searched by.
        exact: full features rather than sketches; by default for at most :data:`EXACT_UP_TO` fabrics. Back ends that
            have no sketches are always exact.

    Raises:
        SimulationError: a simulation of the reference, or of every fabric, did not come to rest.
    """
    cache = features if features is not None else FeatureCache()
    fabrics = [reference, *(entry.parameters for entry in library)]
    # A copy of the reference in the library is another sample of it, not the same pictures again.
    firsts = [0, *(plan.simulations if entry.parameters == reference else 0 for entry in library)]

    failed: dict[int, str] = {}

    def simulate(chosen: Sequence[int]) -> dict[int, dict[Scene, list[DrapeRender]]]:
        simulated = simulate_fabrics(
            [fabrics[k] for k in chosen],
            plan,
            first_repeats=[firsts[k] for k in chosen],
            runner=runner,
            cache=renders,
            keep_failures=True,
            on_done=on_done,
        )
        failed.update({k: s.failure for k, s in zip(chosen, simulated, strict=True) if s.failure})
        _refuse_failures(failed, len(fabrics))
        return {k: s.scenes for k, s in zip(chosen, simulated, strict=True) if not s.failure}

    wants_exact = len(library) <= EXACT_UP_TO if exact is None else exact
    if wants_exact or not isinstance(backend, SquaredEuclideanBackend):
        ranking, pictures = _rank_exactly(library, simulate, backend, cache)
        return SearchResult(ranking, pictures, _failures(library, failed))
    sketched = Sketched(backend)
    store = descriptors if descriptors is not None else DescriptorStore()
    keys = [descriptor_key(f, first, plan, sketched) for f, first in zip(fabrics, firsts, strict=True)]
    found: dict[str, FabricDescriptor] = {key: d for key in keys if (d := store.load(key)) is not None}
    missing = [k for k, key in enumerate(keys) if key not in found]
    for start in range(0, len(missing), _FABRICS_AT_A_TIME):
        chosen = missing[start : start + _FABRICS_AT_A_TIME]
        for k, sets in simulate(chosen).items():
            found[keys[k]] = describe(sets, sketched, cache)
            store.save(keys[k], found[keys[k]])
    if missing:
        store.trim()
    for _ in range((len(keys) - len(missing)) * plan.simulations * len(plan.scenes)):
        _call(on_done)
    ranked = [k for k in range(len(library)) if k + 1 not in failed]
    descriptors_found = [found[keys[k + 1]] for k in ranked]
    ranking = rank_descriptors([library[k] for k in ranked], found[keys[0]], descriptors_found, sketched)
    return SearchResult(ranking, found[keys[0]].pictures, _failures(library, failed))


def rank_descriptors(
    library: Sequence[LibraryFabric],
    reference: FabricDescriptor,
    descriptors: Sequence[FabricDescriptor],
    backend: Sketched,
) -> list[RankedFabric]:
    """Library fabrics by distance of their descriptors from the reference's, the nearest first."""
    ranking = FabricIndex(backend, descriptors).query(reference)
    return [
        RankedFabric(library[r.place].id, r.distance, r.standard_error, descriptors[r.place].pictures) for r in ranking
    ]


def _rank_exactly(
    library: Sequence[LibraryFabric],
    simulate: Callable[[Sequence[int]], dict[int, dict[Scene, list[DrapeRender]]]],
    backend: Backend,
    cache: FeatureCache,
) -> tuple[list[RankedFabric], dict[Scene, NDArray[np.uint8]]]:
    """By full features, a part of the library at a time: the ranking, and the reference's pictures.

    Args:
        library: where to look.
        simulate: renders by number: 0 is the reference, the library's fabrics follow; those that failed are left out.
        backend, cache: as for :func:`search_library`.
    """
    reference, found = simulate([0])[0], []
    for start in range(1, len(library) + 1, _FABRICS_AT_A_TIME):
        chosen = range(start, min(start + _FABRICS_AT_A_TIME, len(library) + 1))
        for number, drapes in simulate(chosen).items():
            result = drape_distance(reference, drapes, backend, cache=cache)
            pictures = {scene: thumbnail(sets[0]) for scene, sets in drapes.items()}
            found.append(RankedFabric(library[number - 1].id, result.distance, result.standard_error, pictures))
    return sorted(found, key=lambda r: r.distance), {scene: thumbnail(sets[0]) for scene, sets in reference.items()}


def _failures(library: Sequence[LibraryFabric], failed: dict[int, str]) -> list[FailedFabric]:
    return [FailedFabric(library[place - 1].id, reason) for place, reason in sorted(failed.items())]


def _refuse_failures(failed: dict[int, str], fabrics: int) -> None:
    """Without the reference, or with nothing to rank, there is no answer."""
    if 0 in failed or len(failed) == fabrics - 1:
        what = "the reference" if 0 in failed else "every fabric of the library"
        raise SimulationError(
            f"{what} could not be simulated: {next(iter(failed.values()))}; try another --seed or a finer --resolution",
            code="simulation_not_still",
        )


def _call(on_done: Callable[[], None] | None) -> None:
    if on_done is not None:
        on_done()
