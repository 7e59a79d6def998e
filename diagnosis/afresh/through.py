"""An effect on the cloth beside one on camera or sensor, simulated at the size that it has there."""

from __future__ import annotations

from collections.abc import Mapping

from diagnosis.afresh.fresh import FreshLook, is_mechanical, moves_camera
from diagnosis.afresh.once import Name
from diagnosis.afresh.refinement import Search, Weigh, seen_through
from diagnosis.afresh.together import SOLVED_NATS
from diagnosis.effects import get_effect
from diagnosis.groups import NOT_EFFECTS
from diagnosis.inference.cause import Cause
from diagnosis.inference.pairs import Pair
from diagnosis.workers import ALONE, Workers

THROUGH_ROUNDS, THROUGH_PAIRS = 2, 2
"""So often at most, and so many pairs each time: alone an effect has another size than beside a camera."""


def look_through(
    looks: Mapping[str, FreshLook], weigh: Weigh, name: Name, scene: str, workers: Workers = ALONE
) -> dict[str, FreshLook]:
    """Of the likeliest pairs of one on the cloth with one on camera or sensor, the former simulated at its size.

    Through a camera, where that moves. What is simulated counts where one of them is then named.

    Args:
        looks: by fabric.
        weigh: see :data:`diagnosis.afresh.refinement.Weigh`.
        name: the answer from results, two effects together included.
        scene: whose captures are looked at.
        workers: that simulate fabrics side by side.

    Returns:
        The same fabrics; as they were where no such pair is likely, or none of these effects is named then.
    """
    search = Search.after(looks, weigh, scene, workers)
    trial = {key: look.copy() for key, look in looks.items()}
    tried: set[str] = set()
    for _ in range(THROUGH_ROUNDS):
        wanted = []
        for pair in with_pictures(name([look.result for look in trial.values()])):
            cloth, other = _cloth_first(pair)
            if search.unseen([(cloth, pair.sizes[cloth])]):
                wanted.append((cloth, other, pair))
        for cloth, other, pair in wanted:
            through = ((other, pair.sizes[other]),) if moves_camera(other) else ()
            trial = search.simulated(trial, [(cloth, pair.sizes[cloth])], through)
            tried.add(cloth)
        if not wanted:
            break
    if not tried:
        return dict(looks)
    found = name([look.result for look in trial.values()])
    if not tried & set(found.named):
        return dict(looks)
    camera = tuple((named, found.size(named)) for named in found.named if moves_camera(named))
    return {key: seen_through(look, camera) for key, look in trial.items()}


def with_pictures(cause: Cause) -> list[Pair]:
    """The likeliest pairs of one effect on the cloth and one that only changes pictures, not far behind the best."""
    single = max(e.log_evidence for name, e in cause.evidence.items() if name not in NOT_EFFECTS)
    tried = sorted(cause.tried, key=lambda pair: -pair.evidence.log_evidence)
    best = max([single, *(pair.evidence.log_evidence for pair in tried[:1])])
    least = max(best - SOLVED_NATS, cause.evidence["none"].log_evidence)
    likely = [pair for pair in tried if pair.evidence.log_evidence > least]
    return [pair for pair in likely if _is_mixed(pair)][:THROUGH_PAIRS]


def _is_mixed(pair: Pair) -> bool:
    effects = [get_effect(name) for name in (pair.first, pair.second)]
    return sum(is_mechanical(effect) for effect in effects) == 1 and not any(e.random_repeats for e in effects)


def _cloth_first(pair: Pair) -> tuple[str, str]:
    """Names of a pair's effect on the cloth and of the other one."""
    if is_mechanical(get_effect(pair.first)):
        return pair.first, pair.second
    return pair.second, pair.first
