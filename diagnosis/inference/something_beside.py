"""Something outside the catalogue, alone or beside one of its effects, as what all fabrics share shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.groups import NOT_EFFECTS
from diagnosis.inference.block import Block, PixelBlock, whiten
from diagnosis.inference.evidence import Evidence
from diagnosis.inference.likelihood import LikelihoodModel, some_off
from diagnosis.inference.pairs import FIRST_EFFECTS, Pair
from diagnosis.inference.remainder import Mixture
from diagnosis.inference.said_again import UNSAID, is_said_again
from diagnosis.inference.subtract import (
    as_seen,
    beside_each_other,
    pixels_without,
    pixels_without_both,
    responses_at_place,
    without_both,
)

Array = NDArray[np.float64]
TOLERATED = 0.7
"""Of what there is to explain, an effect may leave so much: large changes are simulated less well."""
ALONE = 0.75
"""Of something unknown: alone, and not beside an effect of the catalogue; of its effects as many are."""
CHANGED = 0.5
"""A shared number is explained by what changes it by more than this share of how far it is off."""


@dataclass(frozen=True)
class Beside:
    """Something outside the catalogue, as it shows in all fabrics or in shared numbers.

    Attributes:
        evidence: of it, alone or beside one of the best effects.
        repeated: so much of what shared numbers alone say for it only says again what effects say [nats].
    """

    evidence: float
    repeated: float


def something_beside(
    effects: Sequence[str],
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
    evidence: Mapping[str, Evidence],
    shares: Mapping[str, float],
    pairs: Sequence[Pair],
) -> Beside:
    """Log evidence of something outside the catalogue, alone (:data:`ALONE` of the cases) or beside a likely effect.

    It shows in a mixture of changes that is the same for all fabrics, in shared numbers that are off, or in both. What
    a mixture or numbers gain alone is nothing unknown where one of the best effects, or two together, leave little of
    it.
    """
    mixture = Mixture.of(effects, blocks, model)

    def either(mixed: float, numbers: float) -> float:
        return float(logsumexp([mixed, numbers, mixed + numbers], b=[0.5, 0.25, 0.25]))

    left_by = partial(_left_by, mixture, blocks)
    alone, numbers = left_by({}), some_off(pixels, model)
    unexplained, nothing = mixture.evidence(alone), evidence["none"].log_evidence
    tolerated = TOLERATED * max(0.0, float(alone.max()))
    found, said, numbers_said = [], [], []
    rest = sum(share for name, share in shares.items() if name not in NOT_EFFECTS)
    usable = [name for name in effects if not get_effect(name).random_repeats]
    left_by_two = [(pair, left_by(pair.sizes)) for pair in pairs]
    for name in sorted(usable, key=lambda name: -evidence[name].log_evidence)[:FIRST_EFFECTS]:
        size, own = evidence[name].size, evidence[name].log_evidence
        left = left_by({name: size})
        said.append((own - nothing, left, moves_the_camera([name])))
        rest_of = pixels_without(pixels, name, size)
        explained = np.abs(rest_of.measured - pixels.measured) > CHANGED * np.abs(pixels.measured)
        allowed = TOLERATED * max(0.0, some_off(pixels, model, explained))
        off = some_off(rest_of, model)
        numbers_said.append((own - nothing, off))
        beside = off - allowed
        unsaid = mixture.evidence(left, beside=tolerated, exact=moves_the_camera([name]))
        for pair, still in left_by_two:
            gained = pair.evidence.log_evidence - own
            if name not in (pair.first, pair.second):
                continue
            if is_said_again(float(left.max()), float(still.max()), gained):
                unsaid = min(unsaid, gained + mixture.evidence(still, beside=tolerated))
            numbers_left = some_off(pixels_without_both(pixels, pair.sizes), model)
            numbers_said.append((pair.evidence.log_evidence - nothing, numbers_left))
            if numbers_left < UNSAID * beside:
                beside = min(beside, gained + numbers_left - allowed)
        found.append(own + either(unsaid, beside) + np.log((1.0 - ALONE) * shares[name] / rest))
    for pair, left in left_by_two:
        said.append((pair.evidence.log_evidence - nothing, left, moves_the_camera([pair.first, pair.second])))
    for gained, left, exact in said:
        again = is_said_again(float(alone.max()), float(left.max()), gained)
        if again and not (exact and mixture.shows_in_pictures(left)):
            unexplained = min(unexplained, gained + mixture.evidence(left, beside=tolerated))
    repeated = [gained + left for gained, left in numbers_said if is_said_again(numbers, left, gained)]
    unsaid_numbers = min([numbers, *repeated])
    found.append(nothing + either(unexplained, unsaid_numbers) + np.log(ALONE))
    return Beside(float(logsumexp(found)), numbers - unsaid_numbers)


def moves_the_camera(names: Sequence[str]) -> bool:
    """One of some effects moves the camera, and none the cloth: what they do to pictures is known exactly."""
    effects = [get_effect(name) for name in names]
    return any(e.stage is Stage.CAMERA for e in effects) and not any(e.moves_cloth for e in effects)


def _left_by(mixture: Mixture, blocks: Sequence[Block], sizes: Mapping[str, Mapping[str, float]]) -> Array:
    """What mixtures still gain beside effects of some sizes, by family.

    How these would change with their size counts for nothing, nor does how magnets hold.
    """
    usable = [name for name in sizes if not get_effect(name).random_repeats]
    granted = []
    for block in beside_each_other(blocks, usable):
        hold = np.zeros((0, len(block.owner))) if block.grip is None else whiten(block.stated, block.grip[:, None]).T
        own = [responses_at_place(block.stated.responses, *as_seen(block, name, sizes[name])) for name in usable]
        granted.append(np.concatenate([hold, *own]))
    return mixture.gain([block.stated.measured for block in without_both(blocks, sizes)], granted)
