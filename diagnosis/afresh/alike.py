"""What presses the cloth to the panel in another way than the leading effect does, simulated on trial.

A draft, a tilt and an adhesion come near each other in every single fabric, and an adhesion takes hold only once the
cloth has come close: from folds without it, no response says what it does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

from diagnosis.afresh.fresh import FreshLook
from diagnosis.afresh.once import Name
from diagnosis.afresh.refinement import CLOTH_EFFECTS, LATER_CLOTH_EFFECTS, LOOK_ROUNDS, Search, Weigh, leader
from diagnosis.afresh.second import over_the_range
from diagnosis.effect import SCALAR, Effect
from diagnosis.effects import get_effect
from diagnosis.groups import NOT_EFFECTS
from diagnosis.inference.cause import Cause
from diagnosis.workers import ALONE, Workers

ALIKE_SIZES = 2
"""Each is simulated at the middle and the largest of its sizes."""


def most_looks(effects: Sequence[str]) -> int:
    """Simulations of effects for a capture, at most: on trial, and in rounds where that shows more."""
    pressing = _one_of_twins([get_effect(name) for name in effects if get_effect(name).presses])
    if len(pressing) < 2:
        return 0
    return (len(pressing) - 1) * ALIKE_SIZES + LOOK_ROUNDS * (CLOTH_EFFECTS + LATER_CLOTH_EFFECTS)


def look_alike(
    looks: Mapping[str, FreshLook], weigh: Weigh, name: Name, scene: str, workers: Workers = ALONE
) -> dict[str, FreshLook]:
    """Other effects that press the cloth to the panel, where one of them leads.

    What the trial shows counts only where it lets one of these others be named, with the one that leads or likelier
    than that one and its twin together.

    Args:
        looks: by fabric, as :func:`diagnosis.afresh.refinement.look_again` leaves them.
        weigh: see :data:`diagnosis.afresh.refinement.Weigh`.
        name: the answer from results, two effects together included.
        scene: whose captures are looked at again.
        workers: that simulate fabrics side by side.

    Returns:
        The same fabrics; as they were where nothing that presses the cloth leads, or none of the others is named then.
    """
    cause = name([look.result for look in looks.values()])
    others = pressing_otherwise(cause)
    search = Search.after(looks, weigh, scene, workers)
    wanted = search.unseen([(e.name, e.size(size)) for e in others for size in pressing_sizes(e)])
    if not wanted:
        return dict(looks)
    trial = search.rounds(search.simulated({key: look.copy() for key, look in looks.items()}, wanted))
    found = name([look.result for look in trial.values()])
    return trial if shows_another(found, {e.name for e in others}, _with_twin(leader(cause))) else dict(looks)


def pressing_otherwise(cause: Cause) -> list[Effect]:
    """Those that press the cloth while another of them leads so; of two that are twins, the likelier one."""
    first = leader(cause)
    if first is None or cause.evidence[first].size.get(SCALAR, 0.0) * get_effect(first).presses <= 0.0:
        return []
    own = _with_twin(first)
    effects = [get_effect(name) for name in cause.evidence if name not in own and name not in NOT_EFFECTS]
    others = [effect for effect in effects if effect.presses]
    others.sort(key=lambda effect: -cause.evidence[effect.name].log_evidence)
    return _one_of_twins(others)


def _one_of_twins(effects: Sequence[Effect]) -> list[Effect]:
    """The first of two that are twins, and all others."""
    chosen: list[Effect] = []
    for effect in effects:
        if not any(effect.twin is not None and effect.twin.name == other.name for other in chosen):
            chosen.append(effect)
    return chosen


def shows_another(found: Cause, others: Set[str], led: Set[str]) -> bool:
    """One of the others is named, beside what led before or likelier than all of that.

    Args:
        found: the answer after the trial.
        others: names of what was tried.
        led: what led before, with its twin: what speaks for either is shared by both.
    """
    named = set(found.named) & others
    if not named or led & set(found.named):
        return bool(named)
    return max(found.probabilities[name] for name in named) > sum(found.probabilities.get(name, 0.0) for name in led)


def _with_twin(name: str | None) -> Set[str]:
    twin = None if name is None else get_effect(name).twin
    return {n for n in (name, twin.name if twin is not None else None) if n is not None}


def pressing_sizes(effect: Effect) -> list[float]:
    """The middle and the largest size that presses the cloth."""
    return [size for size in over_the_range(effect) if size * effect.presses > 0.0][-ALIKE_SIZES:]
