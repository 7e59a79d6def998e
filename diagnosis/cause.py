"""Probabilities over the catalogue, ``none`` and ``unknown``; one effect or two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.block import Block, PixelBlock
from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.evidence import Evidence, Table, tabulate, tabulate_nothing
from diagnosis.groups import group_of
from diagnosis.likelihood import ALONE_NATS, LikelihoodModel, pixel_log_likelihood, pixel_unknown
from diagnosis.remainder import Mixture
from diagnosis.subtract import as_seen, pixels_together, pixels_without, responses_at_place, together, without
from diagnosis.unknown import tabulate_unknown

Array = NDArray[np.float64]
NOT_EFFECTS = ("none", "unknown")
SECOND_NATS = 2.0
"""A second effect that explains no more than this adds nothing."""
PICKED_UP = 0.3
"""Of what an effect on the cloth gains, so much a second one on the cloth may gain by what the first leaves: large
changes are simulated less well, and what is left of them looks like some other effect."""
REFUTED = 0.1
"""Share of its probability that an effect keeps which brings the simulation no nearer to captures held out from it."""
FIRST_EFFECTS = 3
"""So many of the best single effects are tried together with every other one, or with something unknown."""
REMAINDER_SHARE = 0.5
"""Of ``unknown``: something that shows in what is common to all fabrics, alone or beside an effect."""
REFERENCE_ROUNDS = 4
"""So often another explanation may turn out to be the best one when all are held against it."""
TOLERATED = 0.7
"""Of what there is to explain, an effect may leave so much: large changes are simulated less well."""
SAID, UNSAID = 0.5, 0.35
"""One effect, or two, that gain more than this share of what a mixture gains, and leave less than this, explain it."""


@dataclass(frozen=True)
class CausePrior:
    """Probabilities before anything is seen; the rest is shared by the effects.

    Attributes:
        none, unknown, two: of no effect, of something else, of two effects.
        scatter: how much less probable than another an effect is that can explain any scatter.
        unseen: the same of effects on pixels where the sensor is not stated.
    """

    none: float = 0.265
    unknown: float = 0.18
    two: float = 0.13
    scatter: float = 0.15
    unseen: float = 0.1

    def shares(self, effects: Sequence[str], *, pixels_seen: bool = True) -> dict[str, float]:
        """Of each single explanation."""
        weight = {name: self.scatter if get_effect(name).random_repeats else 1.0 for name in effects}
        if not pixels_seen:
            weight = {n: w * self.unseen if is_on_pixels(n) else w for n, w in weight.items()}
        rest = (1.0 - self.none - self.unknown - self.two) / sum(weight.values())
        return {"none": self.none, "unknown": self.unknown} | {name: rest * w for name, w in weight.items()}


def is_on_pixels(name: str) -> bool:
    """The effect changes pixels rather than the measured surface."""
    return get_effect(name).stage is Stage.SENSOR and name not in ("depth_scale", "depth_bias")


@dataclass(frozen=True)
class Pair:
    """Two effects together.

    Attributes:
        first, second: names; the first explains more alone.
        sizes: of each.
        evidence: of both; its size and interval are the second's.
    """

    first: str
    second: str
    sizes: Mapping[str, Mapping[str, float]]
    evidence: Evidence


@dataclass(frozen=True)
class Cause:
    """What the captures say about the cause.

    Attributes:
        probabilities: explanation to probability; they sum to one. A pair's probability is shared by its two.
        evidence: explanation to its evidence.
        factor: log of the odds of the captures under anything but ``none`` against ``none``.
        pair: the best pair, where one was tried.
        tried: all pairs that were, those included that explain no more than one effect.
        pair_probability: of all pairs.
        alone: what of the probabilities is not a pair's.
    """

    probabilities: Mapping[str, float]
    evidence: Mapping[str, Evidence]
    factor: float
    pair: Pair | None = None
    pair_probability: float = 0.0
    alone: Mapping[str, float] = field(default_factory=dict)
    tried: tuple[Pair, ...] = ()

    @property
    def top(self) -> str:
        """The most probable explanation."""
        return max(self.probabilities, key=lambda name: self.probabilities[name])

    @property
    def named(self) -> tuple[str, ...]:
        """The effects that explain the captures: none, one or two; the most probable first."""
        if self.top in NOT_EFFECTS:
            return ()
        if self.pair is not None and self.pair_probability > 0.5 and self.top in (self.pair.first, self.pair.second):
            return (self.top, self.pair.second if self.top == self.pair.first else self.pair.first)
        return (self.top,)

    def refuted(self) -> Cause:
        """With little probability left for what is named.

        ``none`` and ``unknown`` share the rest as they stand; what two effects together lose, all explanations by one.
        """
        if len(self.named) == 2:
            left = REFUTED * self.pair_probability
            single = {name: p + 1e-300 for name, p in self.alone.items()}
            total = sum(single.values())
            alone = {name: (1.0 - left) * p / total for name, p in single.items()}
            changed = {n: alone[n] + REFUTED * (p - self.alone[n]) for n, p in self.probabilities.items()}
            return replace(self, probabilities=changed, pair_probability=left, alone=alone)
        lost = {name: (1.0 - REFUTED) * self.probabilities[name] for name in self.named}
        calm = {name: self.probabilities[name] + 1e-300 for name in NOT_EFFECTS}
        given = {name: sum(lost.values()) * value / sum(calm.values()) for name, value in calm.items()}
        changed = {n: p - lost.get(n, 0.0) + given.get(n, 0.0) for n, p in self.probabilities.items()}
        return replace(self, probabilities=changed, pair_probability=0.0, alone=changed)

    def size(self, name: str) -> Mapping[str, float]:
        """Fitted size of a named effect."""
        if self.pair is not None and len(self.named) == 2 and name in self.pair.sizes:
            return self.pair.sizes[name]
        return self.evidence[name].size

    def sized_as(self, names: Sequence[str]) -> list[tuple[str, Mapping[str, float]]]:
        """One or two effects, named or not, with the sizes that fit best."""
        pair = next((p for p in self.tried if len(names) == 2 and {p.first, p.second} == set(names)), None)
        return [(name, self.evidence[name].size if pair is None else pair.sizes[name]) for name in names]


def name_cause(
    effects: Sequence[str],
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel = LikelihoodModel(),
    prior: CausePrior = CausePrior(),
    *,
    pairs: bool = True,
) -> Cause:
    """Weigh all explanations against one another.

    Args:
        effects: names to try.
        blocks, pixels: what was measured.
        model, prior: of likelihood and explanations.
        pairs: try two effects together (where the second explains nothing more, there is one), and look for what is
            common to all fabrics beside the best effects.
    """
    tables = [tabulate_nothing(blocks, pixels, model), tabulate_unknown(blocks, pixels, model)]
    still = [float(value.max()) for value in tables[0].blocks]
    tables += [tabulate(get_effect(name), blocks, pixels, model, still) for name in effects]
    shares = prior.shares(effects, pixels_seen=pixels.sensor_known)
    peaks = [max(float(table.blocks[n].max()) for table in tables) for n in range(len(blocks))]
    reference = _reference(tables, blocks, peaks, model, shares)
    alone = {table.name: table.weigh(blocks, reference, model) for table in tables}
    under_peaks, both = {}, []
    if pairs and len(effects) > 1:
        plain = [_as_simulated(table, blocks, pixels, model, still) for table in tables[2:]]
        under_peaks = {
            table.name: table.weigh(blocks, peaks, model) for table in plain
        }  # pairs gain or lose below these
        both = _pairs(effects, blocks, pixels, model, under_peaks, tables[0])
    evidence = {name: _by_more_than_one(e, alone["none"]) for name, e in alone.items()}
    tried = []
    for first, sizes, table in both:
        own = table.weigh(blocks, peaks, model)
        shared = evidence[first].log_evidence + _by_more_than_one(own, under_peaks[first]).log_evidence
        told = replace(own, log_evidence=shared - under_peaks[first].log_evidence)
        tried.append(Pair(first, table.name, sizes, told))
    found = [p for p in tried if p.evidence.log_evidence > evidence[p.first].log_evidence + SECOND_NATS]
    if pairs and len({block.fabric for block in blocks}) > 1:
        besides = _besides(effects, blocks, pixels, model, evidence, shares, found)
        known = evidence["unknown"].log_evidence + np.log1p(-REMAINDER_SHARE)
        total = float(np.logaddexp(known, besides + np.log(REMAINDER_SHARE)))
        evidence["unknown"] = replace(evidence["unknown"], log_evidence=total)
    two = [_beyond_the_first(pair, evidence) for pair in tried]
    found = [pair for pair in two if pair.evidence.log_evidence > evidence[pair.first].log_evidence + SECOND_NATS]
    return replace(_weigh(shares, evidence, found, prior), tried=tuple(tried))


def _reference(
    tables: Sequence[Table],
    blocks: Sequence[Block],
    best: list[float],
    model: LikelihoodModel,
    shares: Mapping[str, float],
) -> list[float]:
    """Log likelihood of each block under the best single explanation, against which all others gain or lose.

    What is best in one block alone would be a reference that nothing reaches: beside it all the others look alike.
    """
    top = None
    for _ in range(REFERENCE_ROUNDS):
        found = {
            table.name: table.weigh(blocks, best, model).log_evidence + np.log(shares[table.name]) for table in tables
        }
        leader = max(tables, key=lambda table: found[table.name])
        if leader is top:
            break
        top = leader
        best = leader.values(blocks, best, model)
    return best


def _besides(
    effects: Sequence[str],
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
    evidence: Mapping[str, Evidence],
    shares: Mapping[str, float],
    pairs: Sequence[Pair],
) -> float:
    """Log evidence of something outside the catalogue, alone (half of the cases) or beside one of the best effects.

    It shows in a mixture of changes that is the same for all fabrics, in shared numbers that are off, or in both. What
    a mixture gains alone is nothing unknown where one of the best effects, or two together, leave little of it.
    """
    mixture = Mixture.of(effects, blocks, model)
    calm = np.zeros((1, len(pixels.measured)))

    def shared(seen: PixelBlock) -> float:
        return pixel_unknown(seen, model) - float(pixel_log_likelihood(seen, calm, model)[0])

    def either(mixed: float, numbers: float) -> float:
        return float(logsumexp([mixed, numbers, mixed + numbers], b=[0.5, 0.25, 0.25]))

    def left_by(sizes: Mapping[str, Mapping[str, float]]) -> Array:
        """What mixtures still gain beside effects of some sizes, how these would change with their size granted."""
        left, usable = list(blocks), [name for name in sizes if not get_effect(name).random_repeats]
        if len(usable) == 2:
            left = [together(block, *usable) for block in left]
        simulated = left
        for name in usable:
            left = [without(block, name, sizes[name]) for block in left]
        own = [
            [responses_at_place(block.stated.responses, *as_seen(block, name, sizes[name])) for name in usable]
            for block in simulated
        ]
        return mixture.gain([block.stated.measured for block in left], [np.concatenate(rows) for rows in own])

    alone, numbers = mixture.gain([block.stated.measured for block in blocks]), shared(pixels)
    unexplained, nothing = mixture.evidence(alone), evidence["none"].log_evidence
    tolerated = TOLERATED * max(0.0, float(alone.max()))
    found, said = [], []
    rest = sum(share for name, share in shares.items() if name not in NOT_EFFECTS)
    usable = [name for name in effects if not get_effect(name).random_repeats]
    for name in sorted(usable, key=lambda name: -evidence[name].log_evidence)[:FIRST_EFFECTS]:
        size = evidence[name].size
        left = left_by({name: size})
        said.append((evidence[name].log_evidence - nothing, left))
        beside = shared(pixels_without(pixels, name, size)) - TOLERATED * max(0.0, numbers)
        mixed = either(mixture.evidence(left, beside=tolerated), beside)
        found.append(evidence[name].log_evidence + mixed + np.log(0.5 * shares[name] / rest))
    said += [(pair.evidence.log_evidence - nothing, left_by(pair.sizes)) for pair in pairs]
    for gained, left in said:
        if is_said_again(float(alone.max()), float(left.max()), gained):
            unexplained = min(unexplained, gained + mixture.evidence(left, beside=tolerated))
    found.append(nothing + either(unexplained, numbers) + np.log(0.5))
    return float(logsumexp(found))


def is_said_again(alone: float, left: float, gained: float) -> bool:
    """Whether a mixture says of a set what one effect, or two, say too: their responses are among what it is mixed of.

    Args:
        alone: what the mixture gains without them.
        left: the same beside them.
        gained: by them [all in nats, against nothing].
    """
    return alone > 0.0 and gained > SAID * alone and left < UNSAID * alone


def _beyond_the_first(pair: Pair, evidence: Mapping[str, Evidence]) -> Pair:
    """Without what the second gains by what the first leaves."""
    if not all(get_effect(name).moves_cloth for name in (pair.first, pair.second)):
        return pair
    gained = max(0.0, evidence[pair.first].log_evidence - evidence["none"].log_evidence)
    own = pair.evidence
    return replace(pair, evidence=replace(own, log_evidence=own.log_evidence - PICKED_UP * gained))


def _by_more_than_one(found: Evidence, other: Evidence) -> Evidence:
    """Without what one fabric alone would gain against another explanation.

    Its folds may be found by chance with an effect on and missed without: what is common to all fabrics shows in two.
    """
    gains = sorted(found.by_fabric[fabric] - other.by_fabric[fabric] for fabric in found.by_fabric)
    if len(gains) < 2:
        return found
    excess = max(0.0, gains[-1] - max(gains[-2], 0.0) - ALONE_NATS)
    return replace(found, log_evidence=found.log_evidence - excess, best=found.best - excess)


def _weigh(
    before: Mapping[str, float], evidence: Mapping[str, Evidence], pairs: list[Pair], prior: CausePrior
) -> Cause:
    rest = sum(share for name, share in before.items() if name not in NOT_EFFECTS)
    weight = {name: e.log_evidence + np.log(before[name]) for name, e in evidence.items()}
    chance = [2 * prior.two * before[p.first] * before[p.second] / rest**2 for p in pairs]
    two = [p.evidence.log_evidence + np.log(share) for p, share in zip(pairs, chance, strict=True)]
    total = float(logsumexp([*weight.values(), *two]))
    alone = {name: float(np.exp(w - total)) for name, w in weight.items()}
    probabilities = dict(alone)
    for pair, w in zip(pairs, two, strict=True):
        probabilities[pair.first] += 0.501 * float(np.exp(w - total))
        probabilities[pair.second] += 0.499 * float(np.exp(w - total))
    others = float(logsumexp([*(w for name, w in weight.items() if name != "none"), *two]))
    factor = others - np.log(1 - prior.none) - evidence["none"].log_evidence
    best = pairs[int(np.argmax(two))] if pairs else None
    return Cause(probabilities, evidence, float(factor), best, float(np.exp(np.array(two) - total).sum()), alone)


def _pairs(
    effects: Sequence[str],
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
    evidence: Mapping[str, Evidence],
    nothing: Table,
) -> list[tuple[str, dict[str, Mapping[str, float]], Table]]:
    """Each of the best effects with every other, the first at its best size given the second; no pair twice."""
    effects = [name for name in effects if not get_effect(name).holds]
    usable = [name for name in effects if not get_effect(name).random_repeats]
    first_names = sorted(usable, key=lambda name: -evidence[name].log_evidence)[:FIRST_EFFECTS]
    found, seen = [], set()
    for first in first_names:
        size: Mapping[str, float] = evidence[first].size
        occam = evidence[first].log_evidence - evidence[first].best
        for second in effects:
            if second in group_of(first) or frozenset({first, second}) in seen:
                continue
            seen.add(frozenset({first, second}))
            own = [together(block, first, second) for block in blocks]
            seen_with = pixels_together(pixels, first, second)
            table = _given(second, first, size, own, seen_with, model, nothing)
            best = [float(values.max()) for values in table.blocks]
            sizes = {first: size, second: table.weigh(blocks, best, model).size}
            if not get_effect(second).random_repeats:
                back = _given(first, second, sizes[second], own, seen_with, model, nothing)
                sizes[first] = back.weigh(blocks, [float(v.max()) for v in back.blocks], model).size
                table = _given(second, first, sizes[first], own, seen_with, model, nothing)
                sizes[second] = table.weigh(blocks, [float(v.max()) for v in table.blocks], model).size
            found.append((first, sizes, replace(table, prior=table.prior + occam)))
    return found


def _as_simulated(
    table: Table, blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel, still: Sequence[float]
) -> Table:
    """An effect's table with responses of no other form; what moves no cloth has no other."""
    effect = get_effect(table.name)
    return tabulate(effect, blocks, pixels, model, still, as_simulated=True) if effect.moves_cloth else table


def _given(
    name: str,
    other: str,
    size: Mapping[str, float],
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
    nothing: Table,
) -> Table:
    """One effect where another of known size is there too; two of any form would fit any folds."""
    left = [without(block, other, size) for block in blocks]
    seen = [float(still.max()) for still in tabulate_nothing(left, pixels, model).blocks]
    if get_effect(other).moves_cloth:  # its response may have left the folds that are seen, too
        seen = [max(own, float(still.max())) for own, still in zip(seen, nothing.blocks, strict=True)]
    return tabulate(get_effect(name), left, pixels_without(pixels, other, size), model, seen, as_simulated=True)
