"""One pin put elsewhere on trial: it may do better than what is named, and no effect moves it so.

A magnet that pulls less lets the cloth fall slack: no response to a small move of it says how. How far captures are
from the simulation with it moved does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from diagnosis.afresh.by_distance import first_capture, known_squares, most, squares_from
from diagnosis.afresh.fresh import FreshLook
from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.inference.cause import Cause, is_on_pixels
from diagnosis.inference.larger import MUCH
from diagnosis.scene import SimulationScene
from diagnosis.simulation.simulator import KeyedDrape
from diagnosis.simulation.sizes import nodes
from diagnosis.tasks.fabric_task import CaptureResult
from diagnosis.workers import ALONE, Workers

SCREENED, SCREEN_M = 2, 0.006
"""So many fabrics are simulated with each pin moved so far in each direction."""
DIRECTIONS = 8
LIKELIEST, SIZES_M = 3, (0.004, 0.006, 0.008)
"""So many of these moves are simulated for all fabrics, at each of these lengths."""
STEP_M, LONGEST_M = 0.002, 0.012
"""While the longest that was tried is the nearest, it is made so much longer, up to this."""
APART_M = 0.0005
"""A length between two that were tried is simulated where it is so far from both."""
MOST_TRIALS = 3 * DIRECTIONS + LIKELIEST * len(SIZES_M) + round((LONGEST_M - SIZES_M[-1]) / STEP_M) + 1
"""Simulations of a fabric whose cloth hangs on three pins, at most."""
OUTDONE = 0.9
"""Of most fabrics' square distances with what is named, a moved pin leaves less than this share."""
OTHER_WAY = math.cos(math.radians(67.5))
"""A move at a smaller angle to an effect's move of the same pin is the effect's, not one of its own."""
SAME_WAY = 1.0 - 1e-6
"""Cosine of the angle between moves of one direction."""


class Move(NamedTuple):
    """Of one pin in the panel's plane [m]."""

    pin: str
    x: float
    y: float


def outdone_by_a_pin(
    looks: Mapping[str, FreshLook], cause: Cause, effects: Sequence[str], scene: str, workers: Workers = ALONE
) -> bool:
    """Whether one pin moved as no effect moves it brings most fabrics nearer than what is named.

    Looked into where the set-up or the camera is named, which moved pins are taken for, or where much is left. Not in
    ``hanging``: there any move may lead to nearer folds. Two fabrics at least must have been seen.

    Args:
        looks: by fabric, when all else has been looked at.
        cause: the answer.
        effects: of the catalogue, that were tried.
        scene: whose captures are looked at.
        workers: that simulate fabrics side by side.
    """
    if scene != "stretch" or not may_be_a_pin(cause):
        return False
    captures = {key: capture for key, look in looks.items() if (capture := first_capture(look, scene)) is not None}
    if len(captures) < 2:  # one fabric's own error may look like anything
        return False
    able = {key: looks[key] for key in captures}
    own = known_squares(able, cause.sized_as(cause.named), scene, workers)
    stated = next(able[key].scene_of(capture) for key, capture in captures.items())

    def left(fabrics: Mapping[str, FreshLook], moves: Sequence[Move]) -> list[tuple[float, Move]]:
        found = squares_from(fabrics, [partial(_with_moved, move=move) for move in moves], scene, workers)
        return sorted((most(each, own[: len(fabrics)]), move) for each, move in zip(found, moves, strict=True))

    screened = left(dict(list(able.items())[:SCREENED]), screening(stated))
    tried = left(able, [_resized(move, size) for _, move in screened[:LIKELIEST] for size in SIZES_M])
    best = tried[0][1]
    if _is_an_effects(best, _moves_of(effects, stated)):
        return False
    one_way = {_length(move): share for share, move in tried if _cosine(move, best) > SAME_WAY}
    return nearest(one_way, lambda size: left(able, [_resized(best, size)])[0][0]) < OUTDONE


def may_be_a_pin(cause: Cause) -> bool:
    """Set-up or camera are named, or what is named leaves much; repeats that scatter are not simulated.

    Not where all that is named shows in pixels: no moved pin is seen there, whatever shapes leave.
    """
    named = [get_effect(name) for name in cause.named]
    if not named or any(effect.random_repeats for effect in named) or all(map(is_on_pixels, cause.named)):
        return False
    much = cause.left is not None and cause.left > MUCH
    return much or any(effect.stage in (Stage.SETUP, Stage.CAMERA) for effect in named)


def screening(scene: SimulationScene) -> list[Move]:
    """Each pin put elsewhere in each direction."""
    turns = [2.0 * math.pi * number / DIRECTIONS for number in range(DIRECTIONS)]
    return [
        Move(pin, SCREEN_M * math.cos(turn), SCREEN_M * math.sin(turn))
        for pin, turn in product(scene.setup.pins_m, turns)
    ]


def _with_moved(look: FreshLook, capture: CaptureResult, move: Move) -> tuple[KeyedDrape, SimulationScene]:
    return capture.base, moved(look.scene_of(capture), move)


def moved(scene: SimulationScene, move: Move) -> SimulationScene:
    """With one pin elsewhere."""
    x, y, z = scene.setup.pins_m[move.pin]
    return scene.with_setup(scene.setup.with_pins(**{move.pin: (x + move.x, y + move.y, z)}))


def nearest(shares: Mapping[float, float], share_at: Callable[[float], float]) -> float:
    """The least share that a move one way leaves, by its length: farther where it still falls, then in between.

    Args:
        shares: by length, as far as known [m].
        share_at: simulates another length.
    """
    known = dict(shares)

    def best() -> float:
        return min(known, key=lambda size: known[size])

    while best() == max(known) and best() + STEP_M <= LONGEST_M + APART_M:
        known[best() + STEP_M] = share_at(best() + STEP_M)
    sizes = sorted(known)
    place = sizes.index(best())
    if 0 < place < len(sizes) - 1:
        around = sizes[place - 1 : place + 2]
        square, slope, _ = np.polyfit(around, [known[size] for size in around], 2)
        lowest = float(-slope / (2.0 * square)) if square > 0.0 else best()
        if min(abs(lowest - size) for size in around) > APART_M:
            known[lowest] = share_at(lowest)
    return min(known.values())


def _length(move: Move) -> float:
    return math.hypot(move.x, move.y)


def _resized(move: Move, size: float) -> Move:
    return Move(move.pin, move.x * size / _length(move), move.y * size / _length(move))


def _moves_of(effects: Sequence[str], scene: SimulationScene) -> list[Move]:
    """How effects on the set-up move each pin."""
    found = []
    for effect in map(get_effect, effects):
        for size in nodes(effect) if effect.stage is Stage.SETUP else []:
            for pin, place in effect.apply(scene, size).setup.pins_m.items():
                x, y, _ = np.subtract(place, scene.setup.pins_m[pin])
                if math.hypot(x, y) > 0.0:
                    found.append(Move(pin, float(x), float(y)))
    return found


def _is_an_effects(move: Move, known: Sequence[Move]) -> bool:
    return any(_cosine(move, other) > OTHER_WAY for other in known)


def _cosine(move: Move, other: Move) -> float:
    """Of the angle between two moves of one pin; of different pins none."""
    if move.pin != other.pin:
        return 0.0
    return (move.x * other.x + move.y * other.y) / _length(move) / _length(other)
