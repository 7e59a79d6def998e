"""Second look: the likeliest effects are simulated at their fitted sizes, and everything is weighed again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from diagnosis.cause import Cause
from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.fabric_task import FabricResult
from diagnosis.fresh import FreshLook, Sized, freshen, is_mechanical

ROUNDS = 2
CANDIDATES, LATER_CANDIDATES = 3, 2
NEAR_NATS = 8.0
"""An effect whose log evidence is further behind is not looked at again."""
CLEARLY_NOTHING = 0.97
"""Probability of ``none`` above which nothing is."""
MOVED = 0.1
"""A size that moves by a larger share is simulated again."""
Weigh = Callable[[Sequence[FabricResult]], Cause]


def look_again(looks: Mapping[str, FreshLook], weigh: Weigh, scene: str) -> dict[str, FreshLook]:
    """Fresh simulations of what may be named.

    Args:
        looks: by fabric.
        weigh: probabilities from results.
        scene: whose captures are looked at again.

    Returns:
        The same fabrics with responses that pass through the fresh simulations.
    """
    seen: dict[str, list[Mapping[str, float]]] = {}
    now = dict(looks)
    for _ in range(ROUNDS):
        cause = weigh([look.result for look in now.values()])
        wanted = [c for c in candidates(cause) if not any(_alike(c[1], size) for size in seen.get(c[0], []))]
        wanted = wanted if not seen else wanted[:LATER_CANDIDATES]
        if not wanted:
            break
        for name, size in wanted:
            seen.setdefault(name, []).append(size)
        now = {f: replace(look, result=freshen(look, wanted, scene)) for f, look in now.items()}
    return now


def candidates(cause: Cause) -> list[Sized]:
    """Mechanical effects that may be the answer, at their best sizes."""
    if cause.probabilities["none"] > CLEARLY_NOTHING:
        return []
    best = max(e.log_evidence for e in cause.evidence.values())
    near = [
        e
        for name, e in cause.evidence.items()
        if e.size and is_mechanical(get_effect(name)) and e.log_evidence > best - NEAR_NATS
    ]
    return [(e.name, e.size) for e in sorted(near, key=lambda e: -e.log_evidence)[:CANDIDATES]]


def _alike(a: Mapping[str, float], b: Mapping[str, float]) -> bool:
    places = all(a[key] == b[key] for key in a if key != SCALAR)
    return places and abs(a[SCALAR] - b[SCALAR]) < MOVED * abs(b[SCALAR])
