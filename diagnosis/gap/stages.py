"""What the effects of each stage, from fabric to sensor, explain of one scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.groups import NOT_EFFECTS
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.inference.cause import Cause, CausePrior, name_cause
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.scatter import with_scatter
from diagnosis.inference.subtract import as_seen, pixels_without, pixels_without_both, response_to, without_both

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lead:
    """What a stage's effects explain of one scene, beside what is named of other stages.

    Attributes:
        stage: it.
        effect: the named effect of this stage, or the one of its effects that explains the scene best.
        size: of that effect, by component and place.
        p: how improbable so much evidence for the stage's effects is where nothing is there.
        gap: length of the difference along what the effect does, in its standard deviations.
        floor: the same in a direction that has nothing to do with the effect, at least 1.
    """

    stage: Stage
    effect: str
    size: Mapping[str, float]
    p: float
    gap: float
    floor: float

    def on_block(self, block: Block) -> Array:
        """Whitened response of a block, [n]; none of an effect that only scatters repeats."""
        if get_effect(self.effect).random_repeats:
            return np.zeros(len(block.owner))
        return response_to(block.stated.responses, *as_seen(block, self.effect, self.size))

    def on_numbers(self, pixels: PixelBlock) -> Array:
        """Response of the shared numbers, [m]; none of an effect that only scatters repeats."""
        if get_effect(self.effect).random_repeats:
            return np.zeros(len(pixels.measured))
        return response_to(pixels.responses, self.effect, self.size)


def find_leads(
    blocks: Sequence[Block], pixels: PixelBlock, cause: Cause, model: LikelihoodModel, *, scatters: bool = True
) -> list[Lead]:
    """Every stage of which an effect was tried, weighed on the captures of one scene alone.

    Named effects of other stages are taken away first, as where two effects together are weighed. What is left is
    weighed with each effect of the stage, as for the set as a whole: its size common to all fabrics and marginalised,
    what one fabric alone says bounded. If nothing (more) is there, the stage's effects, taken together in the
    proportions of their prior, make these measurements more than b times as probable in at most 1/b of cases (Markov's
    inequality): one over that factor is the p-value, as in :func:`diagnosis.gap.detection.detect`.

    Args:
        blocks: of one scene.
        pixels: the numbers that the set shares, or none of them (:func:`no_numbers`).
        cause: found on all captures.
        model: of the likelihood.
        scatters: what repeats do otherwise counts for effects that are others in every repeat; not in ``hanging`` of a
            set that shows ``stretch``, where it tells which folds fell.
    """
    effects = tuple(
        name
        for name in cause.probabilities
        if name not in NOT_EFFECTS and (scatters or not get_effect(name).random_repeats)
    )
    if not effects:
        return []
    shares = CausePrior().shares(effects, pixels_seen=pixels.sensor_known)
    weighed: dict[tuple[str, ...], tuple[list[Block], PixelBlock, Cause]] = {}
    leads = []
    for stage in Stage:
        own = [name for name in effects if get_effect(name).stage is stage]
        if not own:
            continue
        others = tuple(name for name in cause.named if name in effects and get_effect(name).stage is not stage)
        if others not in weighed:
            left, seen = _without_all(blocks, pixels, cause, others)
            weighed[others] = left, seen, name_cause(effects, left, seen, model, pairs=False)
        left, seen, found = weighed[others]
        prior = np.log([shares[name] for name in own])
        gains = np.array([found.evidence[name].log_evidence for name in own]) + prior - logsumexp(prior)
        p = float(np.exp(min(0.0, found.evidence["none"].log_evidence - float(logsumexp(gains)))))
        named = [name for name in cause.named if name in own]
        effect = named[0] if named else own[int(np.argmax(gains))]
        size = cause.size(effect) if named else found.evidence[effect].size
        leads.append(_measured(Lead(stage, effect, size, p, 0.0, 1.0), left, seen, model))
    return leads


def no_numbers(pixels: PixelBlock) -> PixelBlock:
    """Of a scene in which the shared numbers were not taken."""
    return PixelBlock(np.zeros(0), {name: rows[:, :0] for name, rows in pixels.responses.items()}, pixels.sensor_known)


def probable_stage(cause: Cause) -> Stage:
    """The stage whose effects are most probable together."""
    stages = dict.fromkeys(Stage, 0.0)
    for name, probability in cause.probabilities.items():
        if name not in NOT_EFFECTS:
            stages[get_effect(name).stage] += probability
    return max(stages, key=lambda stage: stages[stage])


def _without_all(
    blocks: Sequence[Block], pixels: PixelBlock, cause: Cause, names: Sequence[str]
) -> tuple[list[Block], PixelBlock]:
    """As where two effects are weighed: of two, what each does beside the other; what scatters widens errors."""
    sizes = {name: cause.size(name) for name in names}
    left = list(blocks)
    for name, size in sizes.items():
        if get_effect(name).random_repeats:
            left = with_scatter(left, name, size)
    left = without_both(left, sizes)
    if len(sizes) == 2:
        return left, pixels_without_both(pixels, sizes)
    for name, size in sizes.items():
        pixels = pixels_without(pixels, name, size)
    return left, pixels


def _measured(lead: Lead, blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Lead:
    """With gap and floor in units of one independent error; a response that was taken away left errors of its own."""
    measured, response = [], []
    dimensions = 0.0
    for block in blocks:
        view = block.stated
        count = len(view.measured)
        grown = 1.0 + model.form_share**2 * sum(float(row @ row) for row in view.taken) / count
        scale = np.sqrt(model.dimension_share / grown)
        measured.append(scale * view.measured)
        response.append(scale * lead.on_block(block))
        dimensions += model.dimension_share * count
    spread = np.sqrt(1.0 + model.template_share**2 * sum(row**2 for row in pixels.taken) + pixels.vague)
    seen = np.concatenate([*measured, pixels.measured / spread])
    does = np.concatenate([*response, lead.on_numbers(pixels) / spread])
    dimensions += len(pixels.measured)
    square, length = float(seen @ seen), float(np.linalg.norm(does))
    if get_effect(lead.effect).random_repeats:  # it shows in no direction, but in errors larger than modelled
        return Lead(lead.stage, lead.effect, lead.size, lead.p, float(np.sqrt(square / dimensions)), 1.0)
    along = max(0.0, float(seen @ does)) / length if length > 0.0 else 0.0
    floor = float(np.sqrt(max(1.0, (square - along**2) / max(dimensions - 1.0, 1.0))))
    return Lead(lead.stage, lead.effect, lead.size, lead.p, along, floor)
