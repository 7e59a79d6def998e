"""Second look: the likeliest effects are simulated at their fitted sizes, and everything is weighed again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from diagnosis.afresh.fresh import FreshLook, Sized, is_mechanical, moves_camera
from diagnosis.afresh.outcomes import freshen
from diagnosis.afresh.side_by_side import side_by_side
from diagnosis.effect import Effect
from diagnosis.effects import get_effect
from diagnosis.inference.cause import Cause
from diagnosis.measurement.picture import state_distance
from diagnosis.tasks.fabric_task import FabricResult
from diagnosis.workers import ALONE, Workers

LOOK_ROUNDS, PICTURE_ROUNDS = 2, 4
"""So often at most is looked again: at anything, and where the size of an effect on the camera has moved, for which
nothing but captures' states is sought again."""
CLOTH_EFFECTS, LATER_CLOTH_EFFECTS = 3, 2
"""Effects on the cloth: in the first round, and later or beside those that come near the leader."""
NEAR_NATS, TRIAL_NATS = 5.0, 8.0
"""An effect whose log evidence is further behind is not looked at again; on trial, where nothing leads."""
LOOKS = 2 * LOOK_ROUNDS * (CLOTH_EFFECTS + LATER_CLOTH_EFFECTS) + CLOTH_EFFECTS
"""Simulations of effects for a capture, at most: in rounds, on trial, in rounds again where a trial names something."""
MOVED, MOVED_IN_PICTURES = 0.1, 0.02
"""A size that moves by a larger share is simulated again; of an effect on the camera, seen through again."""
Weigh = Callable[[Sequence[FabricResult], Sized | None], Cause]
"""Probabilities from results, what one effect of some size does taken away beforehand."""


def look_again(
    looks: Mapping[str, FreshLook], weigh: Weigh, scene: str, workers: Workers = ALONE
) -> dict[str, FreshLook]:
    """Fresh simulations of what may be named.

    Where nothing leads then, effects from further behind are simulated on trial: coarse responses hide weak ones. What
    that shows counts only where one of them is named. In the folds of another simulator, which none of these
    simulations find, a wrong effect is often the nearest and yet not near.

    Args:
        looks: by fabric.
        weigh: see :data:`Weigh`.
        scene: whose captures are looked at again.
        workers: that simulate fabrics side by side.

    Returns:
        The same fabrics with responses that pass through the fresh simulations.
    """
    search = Search(weigh, scene, workers)
    now = search.rounds(looks)
    cause = weigh([look.result for look in now.values()], None)
    further = search.unseen(candidates(cause, TRIAL_NATS)) if leader(cause) is None else []
    if not further:
        return now
    trial = search.simulated({key: look.copy() for key, look in now.items()}, further)
    found = weigh([look.result for look in trial.values()], None)
    return search.rounds(trial) if {name for name, _ in further} & set(found.named) else now


@dataclass
class Search:
    """Fresh simulations of effects, each at about one size once.

    Attributes:
        weigh: see :data:`Weigh`.
        scene: whose captures are looked at.
        workers: that simulate fabrics side by side.
        seen: sizes that were simulated so far, by effect.
    """

    weigh: Weigh
    scene: str
    workers: Workers
    seen: dict[str, list[Mapping[str, float]]] = field(default_factory=dict)

    @classmethod
    def after(cls, looks: Mapping[str, FreshLook], weigh: Weigh, scene: str, workers: Workers) -> Search:
        """One that goes on where these looks were left: what all of them have simulated is not simulated again."""
        first, *others = looks.values()
        seen = {
            name: [size for size in sizes if all(size in other.sizes.get(name, []) for other in others)]
            for name, sizes in first.sizes.items()
        }
        return cls(weigh, scene, workers, seen)

    def rounds(self, looks: Mapping[str, FreshLook]) -> dict[str, FreshLook]:
        """What is near the best, and near what is best beside the leader; again where sizes moved."""
        now = dict(looks)
        for number in range(PICTURE_ROUNDS):
            results = [look.result for look in now.values()]
            cause = self.weigh(results, None)
            near = candidates(cause)[: LATER_CLOTH_EFFECTS if number else None]
            first = leader(cause)
            if first is not None:  # a weaker one beside it is far behind it, and yet may be there
                beside = candidates(self.weigh(results, (first, cause.evidence[first].size)))
                cloth = any(get_effect(name).moves_cloth for name, _ in near)
                most = LATER_CLOTH_EFFECTS if number or cloth else CLOTH_EFFECTS
                near += [(n, s) for n, s in beside if n not in {name for name, _ in near}][:most]
            wanted = [(n, s) for n, s in self.unseen(near) if number < LOOK_ROUNDS or moves_camera(n)]
            through = () if first is None or not moves_camera(first) else ((first, cause.evidence[first].size),)
            if not wanted:
                return {key: seen_through(look, through) for key, look in now.items()}
            now = self.simulated(now, wanted, through)
        return now

    def unseen(self, near: Sequence[Sized]) -> list[Sized]:
        """Those that were not simulated at about such sizes yet."""

        def known(name: str, size: Mapping[str, float]) -> bool:
            moved = MOVED_IN_PICTURES if moves_camera(name) else MOVED
            return any(alike(size, other, get_effect(name), moved) for other in self.seen.get(name, []))

        return [(name, size) for name, size in near if not known(name, size)]

    def simulated(
        self, looks: Mapping[str, FreshLook], wanted: Sequence[Sized], through: tuple[Sized, ...] = ()
    ) -> dict[str, FreshLook]:
        """With responses that pass through fresh simulations of these effects too, seen through a camera."""
        for name, size in wanted:
            self.seen.setdefault(name, []).append(size)
        work = partial(_looked_again, wanted=wanted, scene=self.scene, through=through)
        return dict(zip(looks, side_by_side(work, list(looks.values()), self.workers), strict=True))


def _looked_again(look: FreshLook, wanted: Sequence[Sized], scene: str, through: tuple[Sized, ...]) -> FreshLook:
    look = seen_through(look, through)
    return replace(look, result=freshen(look, wanted, scene))


def seen_through(look: FreshLook, through: tuple[Sized, ...]) -> FreshLook:
    """A look whose cloth is seen as the last leader says: through a camera that it moves, or as stated.

    Distances that were measured through another camera are measured again.
    """
    if look.through == through:
        return look
    look = replace(look, through=through)
    depths = {capture.id: capture.depth for capture in look.result.task.captures}
    captures = tuple(
        replace(c, rms_m=state_distance(depths[c.id], c.base.drape, look.seen(c))) for c in look.result.captures
    )
    return replace(look, result=replace(look.result, captures=captures))


def leader(cause: Cause) -> str | None:
    """The likeliest effect, even where something unknown is likelier: simulated at its size it may fit better."""
    name = max(cause.evidence, key=lambda n: cause.probabilities[n] if n != "unknown" else -1.0)
    return None if name == "none" else name


def candidates(cause: Cause, nats: float = NEAR_NATS) -> list[Sized]:
    """Effects on cloth or camera that may be the answer, at their best usual sizes; few of those that must be solved.

    A response of other folds is fitted best where it vanishes: at a size below the effect's range nothing is learnt.
    What speaks for something unknown speaks against none of them yet: as far as they are known, responses are coarse.
    """
    best = max(e.log_evidence for name, e in cause.evidence.items() if name != "unknown")
    near = sorted(
        (e for e in cause.evidence.values() if e.usual and e.usual_evidence > best - nats),
        key=lambda e: -e.usual_evidence,
    )
    solved: list[Sized] = [(e.name, e.usual) for e in near if is_mechanical(get_effect(e.name))]
    rendered: list[Sized] = [(e.name, e.usual) for e in near if moves_camera(e.name)]
    return solved[:CLOTH_EFFECTS] + rendered


def alike(a: Mapping[str, float], b: Mapping[str, float], effect: Effect, moved: float = MOVED) -> bool:
    """Whether two sizes of an effect, at one place, are so near each other that one simulation serves."""
    if any(a[key] != b[key] for key in effect.places[0]):
        return False
    own = list(effect.components)
    difference = np.array([a[key] - b[key] for key in own])
    return float(np.linalg.norm(difference)) < moved * float(np.linalg.norm([b[key] for key in own]))
