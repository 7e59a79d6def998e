"""Search by drape: order a library by distance from a reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from metric.backends import Backend
from metric.drape_distance import drape_distance
from metric.feature_cache import FeatureCache
from metric.library import LibraryFabric
from metric.render_cache import RenderCache
from metric.simulate import Runner, SimulationPlan, simulate_fabrics
from simcore.parameters import FabricParameters


@dataclass(frozen=True)
class RankedFabric:
    """One place of a ranking.

    Attributes:
        id: of the library's fabric.
        distance: drape distance from the reference, in the back end's unit.
        standard_error: of the distance; None with one simulation a scene.
    """

    id: str
    distance: float
    standard_error: float | None


def rank_library(
    reference: FabricParameters,
    library: Sequence[LibraryFabric],
    backend: Backend,
    plan: SimulationPlan,
    *,
    runner: Runner | None = None,
    renders: RenderCache | None = None,
    features: FeatureCache | None = None,
    on_done: Callable[[], None] | None = None,
) -> list[RankedFabric]:
    """Library fabrics by drape distance from a reference, the nearest first; ties keep the library's order.

    Args:
        reference: what to look for.
        library: where to look.
        backend: the image distance.
        plan: how to simulate.
        runner, renders, on_done: as for :func:`metric.simulate.simulate_fabrics`.
        features: as for :func:`metric.drape_distance.drape_distance`.

    Raises:
        SimulationError: a simulation did not come to rest.
    """
    fabrics = [reference, *(entry.parameters for entry in library)]
    # A copy of the reference in the library is another sample of it, not the same pictures again.
    firsts = [0, *(plan.simulations if entry.parameters == reference else 0 for entry in library)]
    simulated = simulate_fabrics(fabrics, plan, first_repeats=firsts, runner=runner, cache=renders, on_done=on_done)
    cache = features if features is not None else FeatureCache()
    found = []
    for entry, drapes in zip(library, simulated[1:], strict=True):
        result = drape_distance(simulated[0].scenes, drapes.scenes, backend, cache=cache)
        found.append(RankedFabric(entry.id, result.distance, result.standard_error))
    return sorted(found, key=lambda r: r.distance)
