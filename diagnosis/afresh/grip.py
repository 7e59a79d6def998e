"""How magnets hold the cloth: at a point or by a patch. Judged where captures fit no explanation as it is stated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.by_distance import first_capture
from diagnosis.afresh.fresh import FreshLook, Sized, is_finite, is_mechanical
from diagnosis.afresh.side_by_side import side_by_side
from diagnosis.effects import get_effect
from diagnosis.inference.cause import Cause
from diagnosis.measurement.picture import noise_square
from diagnosis.simulation.base_state import nearest_state
from diagnosis.simulation.variations import other_radius_m
from diagnosis.tasks.fabric_task import CaptureResult, FabricTask, base_states, with_grip
from diagnosis.workers import ALONE, Workers

Array = NDArray[np.float64]
SCENE = "stretch"
"""There a sample has few fold states, and the magnets decide most."""
EFFECTS = 2
"""So many of the likeliest effects that were simulated are tried with the other magnets, beside none."""
FITS_M = 0.001
"""Captures that the best explanation leaves less than this beyond the noise say nothing against the magnets."""
FLOOR_M = 0.0005
"""Differences below this are alike."""
OTHER_GRIP_LEAVES = 0.5
"""What is left [m²] falls to less than this share (geometric mean of the fabrics) before a set is believed wrong."""
SEVERAL = 4
"""Of so many fabrics the folds of one may have been missed; of three, two that are nearer are not enough."""


@dataclass(frozen=True)
class Grip:
    """What the best explanations leave with either way to hold the cloth.

    Attributes:
        stated, other: root mean square beyond the noise, one number a fabric [m].
    """

    stated: Array
    other: Array

    @property
    def otherwise(self) -> bool:
        """The other way is nearer by far, and in no fabric farther.

        Of :data:`SEVERAL` fabrics or more the one that speaks most against it does not decide alone, where each of the
        others is nearer by far: its folds may have been missed.
        """
        squares = np.sort(2.0 * np.log(self.other / self.stated))
        in_all = squares[-1] <= 0.0
        in_others = len(squares) >= SEVERAL and squares[-2] < np.log(OTHER_GRIP_LEAVES)
        return bool(squares.mean() < np.log(OTHER_GRIP_LEAVES) and (in_all or in_others))

    def sentence(self, stated_m: float, other_m: float) -> str:
        """In words, for the report.

        Args:
            stated_m: what magnets were said to hold round a corner [m].
            other_m: what they were simulated to hold instead; 0: a point.
        """
        way = (
            f"a point of the cloth, not {1e3 * stated_m:.3g} mm round it"
            if other_m == 0.0
            else f"a patch of the cloth ({1e3 * other_m:.3g} mm round a corner), not a point"
        )
        fabrics = "every fabric" if (self.other <= self.stated).all() else "every fabric but one"
        before, after = (1e3 * float(np.exp(np.log(values).mean())) for values in (self.stated, self.other))
        return (
            f"the magnets were taken to hold {way}: so simulated, {SCENE} comes nearer in {fabrics} "
            f"({before:.2f} to {after:.2f} mm beyond the noise); check how they hold it"
        )


def judge_grip(looks: Mapping[str, FreshLook], cause: Cause, workers: Workers = ALONE) -> Grip | None:
    """Whether captures come nearer when magnets hold the cloth another way than stated.

    Args:
        looks: by fabric, with the effects that may be named simulated.
        cause: how likely they are.
        workers: that simulate fabrics side by side.

    Returns:
        None where that was not looked into: fewer than two fabrics in ``stretch``, magnets that are stated to differ
        between captures, cells that are larger than a patch, or captures that fit as it is stated.
    """
    able = [look for look in looks.values() if first_capture(look, SCENE) is not None]
    tasks = [look.result.task for look in looks.values()]
    others = {other_radius_m(c.scene.setup, task.resolution_m) for task in tasks for c in task.captures}
    if len(able) < 2 or len(others) > 1 or any(not _differs(look.result.task) for look in able):
        return None
    tried = _tried(able[0], cause)
    known = np.array([[_known(look, effects) for effects in tried] for look in able])
    if np.exp(np.log(known).mean(axis=0).min()) < FITS_M:
        return None
    stated, other = [*known.T], []  # [explanations][fabrics]
    for effects in tried:  # none first: as a rule that is enough
        searched = side_by_side(partial(_left, effects=effects), able, workers)
        stated.append(np.array([one for one, _ in searched]))
        other.append(np.array([two for _, two in searched]))
        grip = Grip(_best(stated), _best(other))
        if grip.otherwise:
            break
    return grip


def _best(left: Sequence[Array]) -> Array:
    """What the explanation leaves that leaves least, [fabrics]."""
    return min(left, key=lambda one: float(np.log(one).mean()))


def with_other_grip(task: FabricTask) -> FabricTask:
    """The same fabric with magnets that hold a point where they were said to hold a patch, or the reverse.

    All captures' alike: :func:`judge_grip` does not look into sets whose magnets differ.
    """
    return with_grip(task, other_radius_m(task.captures[0].scene.setup, task.resolution_m))


def _differs(task: FabricTask) -> bool:
    """On the cells of a task, a patch holds more than its corner."""
    setup = task.captures[0].scene.setup
    return max(setup.pin_radius_m, other_radius_m(setup, task.resolution_m)) >= task.resolution_m


def _tried(look: FreshLook, cause: Cause) -> list[tuple[Sized, ...]]:
    """None, and the likeliest effects on the cloth at the sizes that were simulated last."""
    solved = [name for name in look.sizes if is_mechanical(get_effect(name)) and name in cause.evidence]
    solved.sort(key=lambda name: -cause.evidence[name].log_evidence)
    return [(), *(((name, look.sizes[name][-1]),) for name in solved[:EFFECTS])]


def _beyond(look: FreshLook, capture: CaptureResult, rms_m: float) -> float:
    """What of a distance is not noise, stated or seen, [m]; no less than what counts as alike."""
    seen = float(capture.measured.pixel_variance(-np.inf))
    return float(np.sqrt(max(rms_m**2 - max(noise_square(look.scene_of(capture)), seen), FLOOR_M**2)))


def _known(look: FreshLook, effects: Sequence[Sized]) -> float:
    """Of the first capture from the nearest state that is known so far."""
    capture = first_capture(look, SCENE)
    assert capture is not None
    return _beyond(look, capture, look.distance(capture, effects))


def _left(look: FreshLook, effects: Sequence[Sized]) -> tuple[float, float]:
    """The same with magnets as stated and otherwise, both searched alike."""
    capture, task = first_capture(look, SCENE), look.result.task
    assert capture is not None
    simulator, fabric, depth = look.simulator, task.parameters, look.task_of(capture).depth
    scene, known = look.seen(capture, effects), look.drape(capture, effects)

    def near(radius_m: float) -> float:
        held = scene.with_setup(replace(scene.setup, pin_radius_m=radius_m))
        starts = base_states(simulator, fabric, held, known.drape.mesh)
        if is_finite(known):  # nothing goes on from what diverged
            starts = [simulator.proceed(known, fabric, held) if held != scene else known, *starts]
        return _beyond(look, capture, nearest_state(simulator, fabric, held, depth, starts)[1])

    stated_m = scene.setup.pin_radius_m
    return near(stated_m), near(other_radius_m(scene.setup, task.resolution_m))
