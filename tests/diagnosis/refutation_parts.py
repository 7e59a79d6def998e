"""Two effects that are named together, and shrinkages that may speak against them."""

from __future__ import annotations

from diagnosis.inference.cause import Cause
from diagnosis.inference.evidence import Evidence
from diagnosis.inference.pairs import Pair
from diagnosis.report import Shrinkage


def shrinkage(fraction: float, high: float, *, afresh: bool = True) -> Shrinkage:
    return Shrinkage(
        held_out=("f1-stretch-0",),
        before=1.0,
        after=1.0 - 0.5 * fraction,
        noise_floor=0.5,
        fraction=fraction,
        interval_90=(-1.0, high),
        simulated_afresh=afresh,
    )


def left(after: float, *, afresh: bool = True) -> Shrinkage:
    """What remains of 4 mm."""
    return shrinkage(0.5, 1.0, afresh=afresh).model_copy(update={"before": 4.0, "after": after})


def two_effects(
    unknown: float, first: str = "edge_flying_pixels", second: str = "stretch_stiffening", both: float = 0.9
) -> Cause:
    """Two effects together so probable; alone, the first of them, or something unknown."""
    evidence = {name: Evidence(name, 0.0, 0.0, {}, {}, {}, 0.0, {}) for name in (first, second, "none", "unknown")}
    alone = {first: 1.0 - both - unknown - 1e-9, second: 0.0, "none": 1e-9, "unknown": unknown}
    together = {**alone, first: alone[first] + both / 2, second: both / 2}
    pair = Pair(first, second, {first: {}, second: {}}, evidence[second])
    return Cause(together, evidence, 10.0, pair, both, alone)
