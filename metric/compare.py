"""Drape distance from fabric parameters: simulate, render, compare."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from metric.backends import Backend
from metric.drape_distance import DrapeDistance, drape_distance
from metric.feature_cache import FeatureCache
from metric.render_cache import RenderCache
from metric.simulate import Retry, Runner, SimulationPlan, simulate_fabrics
from simcore.parameters import FabricParameters


@dataclass(frozen=True)
class Comparison:
    """A drape distance with what it took.

    Attributes:
        result: the distance.
        retries: simulations of both fabrics that needed more than one attempt; ``fabric`` is 0 for a, 1 for b.
    """

    result: DrapeDistance
    retries: list[Retry]


def compare_fabrics(
    a: FabricParameters,
    b: FabricParameters,
    backend: Backend,
    plan: SimulationPlan,
    *,
    runner: Runner | None = None,
    renders: RenderCache | None = None,
    features: FeatureCache | None = None,
    on_done: Callable[[], None] | None = None,
) -> Comparison:
    """Drape distance of two fabrics given by their parameters.

    Two equal fabrics are simulated with different initial forces, so that their distance is that between repeats and
    not zero.

    Args:
        a, b: fabric parameters.
        backend: the image distance.
        plan: how to simulate.
        runner, renders, on_done: as for :func:`metric.simulate.simulate_fabrics`.
        features: as for :func:`metric.drape_distance.drape_distance`.

    Raises:
        SimulationError: a simulation did not come to rest.
    """
    first_repeats = (0, plan.simulations if a == b else 0)
    first, second = simulate_fabrics(
        [a, b], plan, first_repeats=first_repeats, runner=runner, cache=renders, on_done=on_done
    )
    result = drape_distance(first.scenes, second.scenes, backend, cache=features)
    return Comparison(result, [*first.retries, *second.retries])
