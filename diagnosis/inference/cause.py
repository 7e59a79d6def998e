"""Probabilities over the catalogue, ``none`` and ``unknown``; one effect or two."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.groups import NOT_EFFECTS
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.inference.evidence import Evidence, Table, Tables, tabulate, tabulate_nothing
from diagnosis.inference.holds import held, holds_of, log_weights, over_holds, tried_with_two
from diagnosis.inference.larger import larger_than_chance
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.noise import NoiseModel
from diagnosis.inference.one_fabric import by_more_than_one
from diagnosis.inference.pairs import FIRST_EFFECTS, AsHeld, Pair, beyond_the_first, left_by, share_of, weigh_pairs
from diagnosis.inference.something_beside import something_beside
from diagnosis.inference.subtract import without, without_both
from diagnosis.inference.unknown import tabulate_unknown, without_repeated

Array = NDArray[np.float64]
SECOND_NATS = 2.0
"""A second effect that explains no more than this adds nothing."""
REFUTED = 0.1
"""Share of its probability that an effect keeps which brings the simulation no nearer to captures held out from it."""
DOUBTED = 0.05
"""Factor of the odds of two effects against one where held-out captures come no nearer by the second."""
REMAINDER_SHARE = 0.5
"""Of ``unknown``: something that shows in what is common to all fabrics, alone or beside an effect."""
SHOWN_NATS = 0.5
"""An effect that changes the log likelihood by less at any size is not seen by these captures."""
FIRST_SHARE = 0.501
"""Of a pair's probability, its first effect's."""
REFERENCE_ROUNDS = 4
"""So often another explanation may turn out to be the best one when all are held against it."""


@dataclass(frozen=True)
class CausePrior:
    """Probabilities before anything is seen; the rest is shared by the effects.

    Attributes:
        none, unknown, two: of no effect, of something else, of two effects.
        scatter: how much less probable than another an effect is that can explain any scatter.
        unseen: the same of effects that these captures cannot show: those on pixels where the sensor is not stated, and
            those that change nothing that was measured.
    """

    none: float = 0.265
    unknown: float = 0.18
    two: float = 0.13
    scatter: float = 0.15
    unseen: float = 0.1

    def shares(
        self, effects: Sequence[str], *, pixels_seen: bool = True, unshown: Collection[str] = ()
    ) -> dict[str, float]:
        """Of each single explanation."""
        weight = {name: self.scatter if get_effect(name).random_repeats else 1.0 for name in effects}
        hidden = {n for n in effects if n in unshown or (is_on_pixels(n) and not pixels_seen)}
        weight = {n: w * self.unseen if n in hidden else w for n, w in weight.items()}
        rest = (1.0 - self.none - self.unknown - self.two) / sum(weight.values())
        return {"none": self.none, "unknown": self.unknown} | {name: rest * w for name, w in weight.items()}


def is_on_pixels(name: str) -> bool:
    """The effect changes pixels rather than the measured surface."""
    return get_effect(name).stage is Stage.SENSOR and name not in ("depth_scale", "depth_bias")


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
        left: mean square of what the most probable explanation leaves in most fabrics
            (:func:`diagnosis.inference.larger.usual_square`); None where that was not looked at.
        likelihood: log likelihood of the captures' shapes and shared numbers, over all explanations.
        errors: that it was weighed under (:mod:`diagnosis.inference.granted`).
        pair_share: of all pairs' probability, the best one's, with those in which declared twins stand for its effects.
        refuted_before: effects that were named, and are not since held-out captures refuted them.
    """

    probabilities: Mapping[str, float]
    evidence: Mapping[str, Evidence]
    factor: float
    pair: Pair | None = None
    pair_probability: float = 0.0
    alone: Mapping[str, float] = field(default_factory=dict)
    tried: tuple[Pair, ...] = ()
    left: float | None = None
    likelihood: float = -np.inf
    errors: NoiseModel = NoiseModel()
    pair_share: float = 1.0
    refuted_before: frozenset[str] = frozenset()

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
            return self._with_pairs(REFUTED * self.pair_probability)
        changed = self._to_no_effect((1.0 - REFUTED) * self.probabilities[self.top])
        return replace(self, probabilities=changed, pair_probability=0.0, alone=changed)

    def second_doubted(self, times: int = 1) -> Cause:
        """With the odds of two effects against one lowered by what held-out captures say, once or more often.

        These are few, and distances hardly show what is narrow, as a crease is: they are one more piece of evidence.
        """
        odds = DOUBTED**times * self.pair_probability
        return self._with_pairs(odds / (odds + 1.0 - self.pair_probability))

    def pairs_at_most(self, most: float) -> Cause:
        """With no more probability than ``most`` for two effects; explanations by one share the rest as they stand."""
        return self._with_pairs(min(most, self.pair_probability))

    def outdone(self) -> Cause:
        """With little probability left for any effect: something outside the catalogue gets what they lose."""

        def kept(probabilities: Mapping[str, float]) -> dict[str, float]:
            return {n: p if n in NOT_EFFECTS else REFUTED * p for n, p in probabilities.items()}

        changed, alone = kept(self.probabilities), kept(self.alone)
        lost = 1.0 - sum(changed.values())
        pairs = REFUTED * self.pair_probability
        return replace(
            self,
            probabilities=changed | {"unknown": changed["unknown"] + lost},
            pair_probability=pairs,
            alone=alone | {"unknown": alone["unknown"] + lost},
        )

    def _with_pairs(self, left: float) -> Cause:
        """With this probability for all pairs; explanations by one share the rest as they stand."""
        single = {name: p + 1e-300 for name, p in self.alone.items()}
        total, share = sum(single.values()), left / self.pair_probability
        alone = {name: (1.0 - left) * p / total for name, p in single.items()}
        changed = {  # differences of sums of exponentials, which round
            n: min(1.0, alone[n] + share * max(0.0, p - self.alone[n])) for n, p in self.probabilities.items()
        }
        return replace(self, probabilities=changed, pair_probability=left, alone=alone)

    def doubted(self, most: float) -> Cause:
        """With no more probability than ``most`` for the one effect that is named, as by :meth:`refuted`."""
        lost = max(0.0, self.probabilities[self.top] - most)
        alone = {n: max(0.0, p - lost) if n == self.top else p for n, p in self.alone.items()}
        return replace(self, probabilities=self._to_no_effect(lost), alone=alone)

    def _to_no_effect(self, lost: float) -> dict[str, float]:
        """What the most probable explanation loses is shared by ``none`` and ``unknown`` as they stand."""
        calm = {name: self.probabilities[name] + 1e-300 for name in NOT_EFFECTS}
        given = {name: lost * value / sum(calm.values()) for name, value in calm.items()} | {self.top: -lost}
        return {name: p + given.get(name, 0.0) for name, p in self.probabilities.items()}

    @property
    def both_probability(self) -> float:
        """That the best pair's two effects, or declared twins of them, are both there."""
        return min(1.0, self.pair_probability * self.pair_share)  # of sums of exponentials, which round

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
    holds = holds_of(blocks)
    weights = log_weights(holds)
    as_held = [[held(block, share) for block in blocks] for share in holds]
    by_hold = [_tables(effects, blocks, pixels, model)]
    by_hold += [_otherwise(by_hold[0], blocks, own, pixels, model) for own in as_held[1:]]
    tables = _over_holds(by_hold, weights)
    shares = prior.shares(effects, pixels_seen=pixels.sensor_known, unshown=_unshown(by_hold[0]))
    peaks = [max(float(table.blocks[n].max()) for table in tables) for n in range(len(blocks))]
    reference = _reference(tables, blocks, peaks, model, shares)
    alone = {table.name: table.weigh(blocks, reference, model) for table in tables}
    evidence = {name: by_more_than_one(e, alone["none"]) for name, e in alone.items()}
    tried: list[Pair] = []
    if pairs and len(effects) > 1:
        chances = [
            [t.weigh(blocks, reference, model).log_evidence + np.log(shares[t.name]) for t in own] for own in by_hold
        ]
        ways = [AsHeld(as_held[n], by_hold[n], float(weights[n])) for n in tried_with_two(chances, weights)]
        tried = weigh_pairs(effects, blocks, pixels, model, ways, peaks, evidence)
    found = [p for p in tried if p.evidence.log_evidence > evidence[p.first].log_evidence + SECOND_NATS]
    if pairs and len({block.fabric for block in blocks}) > 1:
        besides = something_beside(effects, blocks, pixels, model, evidence, shares, found)
        nothing = evidence["none"].log_evidence
        larger = larger_than_chance(as_held, _said(as_held, evidence, found))
        unsaid = without_repeated(tables.unknown, tables.nothing, besides.repeated).weigh(blocks, reference, model)
        known = by_more_than_one(unsaid, alone["none"]).log_evidence
        known = max(known, nothing + larger) + np.log1p(-REMAINDER_SHARE)
        total = float(np.logaddexp(known, besides.evidence + np.log(REMAINDER_SHARE)))
        evidence["unknown"] = replace(evidence["unknown"], log_evidence=total)
    two = [beyond_the_first(pair, evidence, as_held) for pair in tried]
    found = [pair for pair in two if pair.evidence.log_evidence > evidence[pair.first].log_evidence + SECOND_NATS]
    cause = _weigh(shares, evidence, found, prior)
    cause = replace(cause, tried=tuple(tried), likelihood=cause.likelihood + float(sum(reference)))
    return replace(cause, left=_left_by(cause, as_held)) if pairs else cause


def _left_by(cause: Cause, ways: Sequence[Sequence[Block]]) -> float | None:
    """What the named effects leave in most fabrics, by the way magnets may hold that leaves least."""
    sizes = {name: cause.size(name) for name in cause.named if not get_effect(name).random_repeats}
    return left_by(ways, sizes)


def _said(
    ways: Sequence[Sequence[Block]], evidence: Mapping[str, Evidence], pairs: Sequence[Pair]
) -> Iterator[tuple[float, list[list[Block]] | None]]:
    """What the best effects, alone and two together, gain over nothing, and the blocks without them, however magnets
    hold.
    """
    nothing = evidence["none"].log_evidence
    names = sorted((n for n in evidence if n not in NOT_EFFECTS), key=lambda n: -evidence[n].log_evidence)
    for name in names[:FIRST_EFFECTS]:
        scatter = get_effect(name).random_repeats
        size = evidence[name].size
        left = None if scatter else [[without(block, name, size) for block in blocks] for blocks in ways]
        yield evidence[name].log_evidence - nothing, left
    for pair in pairs:
        yield pair.evidence.log_evidence - nothing, [without_both(blocks, pair.sizes) for blocks in ways]


def _tables(effects: Sequence[str], blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Tables:
    nothing = tabulate_nothing(blocks, pixels, model)
    still = [float(value.max()) for value in nothing.blocks]
    found = tuple(tabulate(get_effect(name), blocks, pixels, model, still) for name in effects)
    return Tables(nothing, tabulate_unknown(blocks, pixels, model), found)


def _over_holds(by_hold: Sequence[Tables], weights: Array) -> Tables:
    """Every explanation over all ways in which magnets may hold."""
    nothing = over_holds([tables.nothing for tables in by_hold], weights)
    unknown = over_holds([tables.unknown for tables in by_hold], weights)
    effects = zip(*(tables.effects for tables in by_hold), strict=True)
    return Tables(nothing, unknown, tuple(over_holds(same, weights) for same in effects))


def _unshown(tables: Tables) -> frozenset[str]:
    """Effects that at no size make any difference to what was measured; of a vector only the best size is known."""
    nothing, still = tables.nothing, [float(value.max()) for value in tables.nothing.blocks]

    def shown(table: Table) -> float:
        cells = sum(np.abs(value - none) for value, none in zip(table.blocks, still, strict=True))
        return float((cells + np.abs(table.pixels - float(nothing.pixels.max()))).max())

    return frozenset(table.name for table in tables.effects if not table.sigma and shown(table) < SHOWN_NATS)


def _otherwise(
    stated: Tables,
    blocks: Sequence[Block],
    changed: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
) -> Tables:
    """The same where some blocks are changed; the others are weighed again only where a fit goes over all of them."""
    own = [n for n, (block, other) in enumerate(zip(blocks, changed, strict=True)) if other is not block]
    names = [table.name for table in stated if table.name not in NOT_EFFECTS and not get_effect(table.name).vector]
    weighed = {table.name: table for table in _tables(names, [changed[n] for n in own], pixels, model)}

    def otherwise(table: Table) -> Table:
        new = weighed.get(table.name)
        if new is None:
            return tabulate(get_effect(table.name), changed, pixels, model)
        values = list(table.blocks)
        for n, value in zip(own, new.blocks, strict=True):
            values[n] = value
        return replace(new, blocks=tuple(values))

    return Tables(otherwise(stated.nothing), otherwise(stated.unknown), tuple(map(otherwise, stated.effects)))


def _reference(
    tables: Tables,
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


def _weigh(
    before: Mapping[str, float], evidence: Mapping[str, Evidence], pairs: list[Pair], prior: CausePrior
) -> Cause:
    """Probabilities; the likelihood is over that of the reference that evidence is held against."""
    rest = sum(share for name, share in before.items() if name not in NOT_EFFECTS)
    weight = {name: e.log_evidence + np.log(before[name]) for name, e in evidence.items()}
    chance = [2 * prior.two * before[p.first] * before[p.second] / rest**2 for p in pairs]
    two = [p.evidence.log_evidence + np.log(share) for p, share in zip(pairs, chance, strict=True)]
    total = float(logsumexp([*weight.values(), *two]))
    alone = {name: float(np.exp(w - total)) for name, w in weight.items()}
    probabilities = shared(alone, pairs, [float(np.exp(w - total)) for w in two])
    others = float(logsumexp([*(w for name, w in weight.items() if name != "none"), *two]))
    factor = others - np.log(1 - prior.none) - evidence["none"].log_evidence
    best = pairs[int(np.argmax(two))] if pairs else None
    pair_probability = min(1.0, float(np.exp(np.array(two) - total).sum()))
    cause = Cause(probabilities, evidence, float(factor), best, pair_probability, alone, likelihood=total)
    return cause if best is None else replace(cause, pair_share=share_of(best, pairs, two))


def shared(alone: Mapping[str, float], pairs: Sequence[Pair], two: Sequence[float]) -> dict[str, float]:
    """Probabilities of all explanations, each pair's shared by its two effects.

    In halves, the first a little more; where two effects together are more probable than anything by one, unevenly if
    need be: an effect of the best pair gets so much of all its pairs that nothing else is the most probable.

    Args:
        alone: explanations by one.
        pairs, two: two effects, and how probable they are together.
    """
    preferred, share = None, FIRST_SHARE
    if sum(two) > 0.5:
        best = pairs[int(np.argmax(two))]
        masses = {name: _mass(name, pairs, two) for name in (best.first, best.second)}
        preferred = max(masses, key=lambda name: masses[name])
        needed = (FIRST_SHARE / 0.5 * max(alone.values()) - alone[preferred]) / masses[preferred]
        share = min(1.0, max(FIRST_SHARE, needed))
    found = dict(alone)
    for pair, p in zip(pairs, two, strict=True):
        first, second = (pair.second, pair.first) if pair.second == preferred else (pair.first, pair.second)
        own = share if first == preferred else FIRST_SHARE
        found[first] += own * p
        found[second] += (1.0 - own) * p
    return found


def _mass(name: str, pairs: Sequence[Pair], two: Sequence[float]) -> float:
    """Probability of all pairs that an effect is one of."""
    return sum(p for pair, p in zip(pairs, two, strict=True) if name in (pair.first, pair.second))
