"""What all fabrics' results come to: what is weighed together, what has to be said of them, and what they cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from diagnosis.afresh.fresh import FreshLook
from diagnosis.inference.block import Block, PixelBlock, make_block, make_pixel_block
from diagnosis.inference.noise import NoiseModel
from diagnosis.simulation.simulator import Cost
from diagnosis.tasks.enough import partly_seen
from diagnosis.tasks.fabric_task import FabricResult, not_at_rest


def all_alike(noise: NoiseModel) -> NoiseModel:
    """Errors beside how magnets hold, which explanations are averaged over for all fabrics alike."""
    return replace(noise, grip_alike=True)


def make_blocks(results: Sequence[FabricResult], noise: NoiseModel) -> list[Block]:
    """Fabric by fabric, scene by scene."""
    return [
        make_block(
            [c for c in result.captures if c.scene == scene],
            result.task.relative_sigma,
            noise,
            result.task.parameters.density,
        )
        for result in results
        for scene in ("hanging", "stretch")
        if any(c.scene == scene for c in result.captures)
    ]


def make_pixels(results: Sequence[FabricResult], noise: NoiseModel) -> PixelBlock:
    """Of all captures."""
    return make_pixel_block([c for r in results for c in r.captures], noise)


def half_estimated(results: Sequence[FabricResult]) -> bool:
    """Parameters of half of the fabrics or more are estimated from the captures."""
    return 2 * sum(result.task.estimated for result in results) >= len(results)


def said_of_states(results: Sequence[FabricResult]) -> list[str]:
    """What has to be said of captures and of the states that stand for them."""
    return [
        *partly_seen({c.id: (c.measured, c.reference) for r in results for c in r.captures}),
        *not_at_rest(results),
    ]


def cost_of(results: Sequence[FabricResult], looks: Mapping[str, FreshLook], before: Cost) -> Cost:
    """Of all simulations, ``before`` and since."""
    cost = Cost()
    cost.add(before)
    for account in (*(r.cost for r in results), *(look.simulator.cost for look in looks.values())):
        cost.add(account)
    return cost
