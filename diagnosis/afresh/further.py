"""Where much stays unexplained, the catalogue's effects on the cloth are simulated on trial."""

from __future__ import annotations

from collections.abc import Mapping

from diagnosis.afresh.by_distance import most, squares
from diagnosis.afresh.fresh import FreshLook, Sized, is_mechanical, moves_camera
from diagnosis.afresh.once import Name
from diagnosis.afresh.refinement import CLOTH_EFFECTS, LATER_CLOTH_EFFECTS, LOOK_ROUNDS, Search, Weigh, leader
from diagnosis.effects import get_effect
from diagnosis.inference.cause import Cause
from diagnosis.inference.larger import MUCH
from diagnosis.workers import ALONE, Workers

FURTHER = 6
"""So many effects on the cloth are simulated on trial."""
AS_NEAR, MOST_AS_NEAR = 3.0, 3
"""Beside one that is named, the nearest others are simulated on trial, so many at most, where most fabrics' square
distances are below this times those with it, when they simply come on: folds that captures lead to are nearer."""
TRIAL_LOOKS = FURTHER + LOOK_ROUNDS * (CLOTH_EFFECTS + LATER_CLOTH_EFFECTS)
"""Simulations of effects for a capture, at most: on trial, and in rounds where that shows more."""


def look_further(
    looks: Mapping[str, FreshLook], weigh: Weigh, name: Name, scene: str, workers: Workers = ALONE
) -> dict[str, FreshLook]:
    """The catalogue's likeliest effects on the cloth on trial, where the answer leaves much unexplained.

    Coarse responses from folds that hold no effect can hide even a strong one, above all beside another on the camera.
    What the trial shows counts only where it lets one of these effects be named.

    Args:
        looks: by fabric, as :func:`look_again` leaves them.
        weigh: see :data:`diagnosis.afresh.refinement.Weigh`.
        name: the answer from results, two effects together included.
        scene: whose captures are looked at again.
        workers: that simulate fabrics side by side.

    Returns:
        The same fabrics; as they were where all is explained or the trial names none of the effects that are tried.
    """
    results = [look.result for look in looks.values()]
    cause = name(results)
    if not leaves_much(cause):
        return dict(looks)
    search = Search.after(looks, weigh, scene, workers)
    first = leader(cause)
    shown = None if first is None or is_mechanical(get_effect(first)) else (first, cause.evidence[first].size)
    further = search.unseen(on_the_cloth(weigh(results, shown)))[:FURTHER]
    if cause.named and shown is None:
        further = _as_near(looks, (cause.top, cause.evidence[cause.top].size), further, scene, workers)
    if not further:
        return dict(looks)
    through = () if shown is None or not moves_camera(shown[0]) else (shown,)
    trial = search.simulated({key: look.copy() for key, look in looks.items()}, further, through)
    trial = search.rounds(trial)
    found = name([look.result for look in trial.values()])
    return trial if {tried for tried, _ in further} & set(found.named) else dict(looks)


def _as_near(
    looks: Mapping[str, FreshLook], named: Sized, others: list[Sized], scene: str, workers: Workers
) -> list[Sized]:
    """Of other effects the nearest that bring most fabrics about as near to their captures as the named one, all of
    them simply coming on; the nearest first.
    """
    others = [other for other in others if other[0] != named[0]]
    own, *rest = squares(looks, [(named,), *((other,) for other in others)], scene, workers)
    near = sorted(zip([most(found, own) for found in rest], range(len(others)), strict=True))
    return [others[number] for left, number in near[:MOST_AS_NEAR] if left < AS_NEAR]


def leaves_much(cause: Cause) -> bool:
    """Something unknown is the answer, or what is named leaves more in most fabrics than simulators differ by.

    What an effect on the cloth leaves may be its own, simulated less well, or that of another one that only comes near
    it.
    """
    return cause.top == "unknown" or (bool(cause.named) and cause.left is not None and cause.left > MUCH)


def on_the_cloth(cause: Cause) -> list[Sized]:
    """All effects on the cloth that can be simulated again, the likeliest first, at their best usual sizes."""
    able = [e for e in cause.evidence.values() if e.usual and is_mechanical(get_effect(e.name))]
    return [(e.name, e.usual) for e in sorted(able, key=lambda e: -e.usual_evidence)]
