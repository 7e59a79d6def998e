"""Two effects together: each of the best with every other one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.effects import get_effect
from diagnosis.groups import group_of
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.inference.evidence import Evidence, Table, Tables, or_unmoved, tabulate, tabulate_nothing
from diagnosis.inference.holds import over_holds
from diagnosis.inference.larger import MUCH, usual_square
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.one_fabric import by_more_than_one
from diagnosis.inference.scatter import with_scatter
from diagnosis.inference.subtract import pixels_together, pixels_without, together, without, without_both

Array = NDArray[np.float64]
FIRST_EFFECTS = 3
"""So many of the best single effects are tried together with every other one, or with something unknown."""
PICKED_UP = 0.3
"""Of what an effect on the cloth gains, so much a second one on the cloth may gain by what the first leaves: large
changes are simulated less well, and what is left of them looks like some other effect."""


HALVED = 0.5
"""Of what the first leaves, both leave less than this share where nothing is picked up."""


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

    def is_as(self, other: Pair) -> bool:
        """Of the same two effects, or of declared twins of them."""
        ways = ((other.first, other.second), (other.second, other.first))
        return any(self.first in group_of(one) and self.second in group_of(two) for one, two in ways)


def share_of(one: Pair, pairs: Sequence[Pair], log_weights: Sequence[float]) -> float:
    """Of all pairs' probability, that of one and of those in which declared twins stand for its effects.

    Args:
        one: of the pairs.
        pairs: all of them.
        log_weights: of each, log of its probability, from any origin.
    """
    own = [weight for pair, weight in zip(pairs, log_weights, strict=True) if pair.is_as(one)]
    return float(np.exp(logsumexp(own) - logsumexp(log_weights)))


@dataclass(frozen=True)
class AsHeld:
    """All explanations by one with magnets that hold in one way.

    Attributes:
        blocks: what was measured, less what the magnets do.
        tables: of all of them.
        weight: log probability of these magnets.
    """

    blocks: Sequence[Block]
    tables: Tables
    weight: float


def weigh_pairs(
    effects: Sequence[str],
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
    ways: Sequence[AsHeld],
    peaks: Sequence[float],
    evidence: Mapping[str, Evidence],
) -> list[Pair]:
    """Of each of the best effects with every other one.

    Args:
        effects: names to try.
        blocks, pixels, model: what was measured, and how likely it is.
        ways: how magnets may hold.
        peaks: log likelihood of each block under what fits it best alone: pairs gain or lose below these.
        evidence: of single explanations.
    """
    weights = np.array([way.weight for way in ways])
    plain = [_as_simulated(way.tables, way.blocks, pixels, model) for way in ways]
    plain = [[_fixed(table, way, pixels, peaks, model) for table in own] for way, own in zip(ways, plain, strict=True)]
    under_peaks = {
        same[0].name: over_holds(same, weights).weigh(blocks, peaks, model) for same in zip(*plain, strict=True)
    }
    able = [name for name in effects if not get_effect(name).holds]
    first_names = sorted(able, key=lambda name: -under_peaks[name].log_evidence)[:FIRST_EFFECTS]
    both = []
    for way, tables in zip(ways, plain, strict=True):
        alone = {table.name: table.weigh(blocks, peaks, model) for table in tables if table.name in first_names}
        both.append(_pairs(first_names, able, way.blocks, pixels, model, alone, way.tables.nothing))
    found = []
    for same in zip(*both, strict=True):
        each = [table.weigh(blocks, peaks, model) for _, _, table in same]
        total = weights + np.array([one.log_evidence for one in each])
        top = int(np.argmax(total))
        first, sizes, table = same[top]
        own = by_more_than_one(replace(each[top], log_evidence=float(logsumexp(total))), under_peaks[first])
        told = evidence[first].log_evidence + own.log_evidence - under_peaks[first].log_evidence
        sizes = {**sizes, table.name: each[top].size}  # which the interval belongs to
        found.append(Pair(first, table.name, sizes, replace(each[top], log_evidence=told)))
    return found


def beyond_the_first(pair: Pair, evidence: Mapping[str, Evidence], ways: Sequence[Sequence[Block]] = ()) -> Pair:
    """Without what the second gains by what the first leaves.

    Not where the first leaves much more in most fabrics than simulators differ by, and both half of it or less, the
    second at a size that it may have: what large changes leave for being simulated less well, no other effect takes
    away in all fabrics.

    Args:
        pair: as weighed.
        evidence: of single explanations.
        ways: blocks, one way or several in which magnets may hold; the calmest counts.
    """
    first, second = get_effect(pair.first), get_effect(pair.second)
    if not first.moves_cloth or not (second.moves_cloth or second.random_repeats):
        return pair
    if not second.random_repeats and is_usual(pair.second, pair.sizes[pair.second]):
        alone = left_by(ways, {pair.first: evidence[pair.first].size})
        both = left_by(ways, pair.sizes)
        if alone is not None and both is not None and alone > MUCH and both < HALVED * alone:
            return pair
    gained = max(0.0, evidence[pair.first].log_evidence - evidence["none"].log_evidence)
    own = pair.evidence
    return replace(pair, evidence=replace(own, log_evidence=own.log_evidence - PICKED_UP * gained))


def is_usual(name: str, size: Mapping[str, float]) -> bool:
    """An effect, or its vector, is no weaker than its prior says."""
    effect = get_effect(name)
    components = effect.components
    length = float(np.linalg.norm([size[key] for key in components]))
    if not effect.vanishes_at_zero:  # the larger, the weaker
        return length <= max(component.high for component in components.values())
    return length >= min(component.low for component in components.values())


def left_by(ways: Sequence[Sequence[Block]], sizes: Mapping[str, Mapping[str, float]]) -> float | None:
    """What effects of these sizes leave in most fabrics, by the way magnets may hold that leaves least.

    Args:
        ways: blocks, one way or several in which magnets may hold.
        sizes: of one effect or two, by name; of none, what there is.

    Returns:
        As :func:`diagnosis.inference.larger.usual_square`; None where too few fabrics were seen.
    """
    squares = [usual_square(without_both(blocks, sizes)) for blocks in ways]
    return min((square for square in squares if square is not None), default=None)


def _pairs(
    first_names: Sequence[str],
    effects: Sequence[str],
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
    evidence: Mapping[str, Evidence],
    nothing: Table,
) -> list[tuple[str, dict[str, Mapping[str, float]], Table]]:
    """Each of the best effects with every other, the first at its best size given the second; no pair twice.

    ``evidence`` of the first ones is that with the same magnets: what their size costs, and not how probable these are.
    """
    found, seen = [], set()
    for first in first_names:
        size: Mapping[str, float] = evidence[first].size
        scatters = get_effect(first).random_repeats
        wider = with_scatter(blocks, first, size) if scatters else None
        for second in effects:
            if second in group_of(first) or frozenset({first, second}) in seen:
                continue
            seen.add(frozenset({first, second}))
            occam = evidence[first].log_evidence - evidence[first].best
            own = wider or [together(block, first, second) for block in blocks]
            seen_with = pixels_together(pixels, first, second)
            table = _given(second, first, size, own, seen_with, model, nothing)
            best = [float(values.max()) for values in table.blocks]
            sizes = {first: size, second: table.weigh(blocks, best, model).size}
            if not any(get_effect(name).random_repeats for name in (first, second)):
                back = _given(first, second, sizes[second], own, seen_with, model, nothing)
                sizes[first] = back.weigh(blocks, [float(v.max()) for v in back.blocks], model).size
                if not get_effect(first).vector:  # at another place or size, which may be less probable
                    occam += back.chance(sizes[first]) - back.chance(size)
                table = _given(second, first, sizes[first], own, seen_with, model, nothing)
                sizes[second] = table.weigh(blocks, [float(v.max()) for v in table.blocks], model).size
            found.append((first, sizes, replace(table, prior=table.prior + occam)))
    return found


def _fixed(table: Table, way: AsHeld, pixels: PixelBlock, peaks: Sequence[float], model: LikelihoodModel) -> Table:
    """An effect that is another in every repeat, at its best size: as it is when another one is tried beside it."""
    if not get_effect(table.name).random_repeats:
        return table
    found = table.weigh(way.blocks, peaks, model)
    alone = tabulate_nothing(with_scatter(way.blocks, table.name, found.size), pixels, model)
    prior = np.array([found.log_evidence - found.best])
    return replace(table, blocks=alone.blocks, pixels=alone.pixels, prior=prior, sizes=(found.size,))


def _as_simulated(tables: Tables, blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> list[Table]:
    """Effects' tables with responses of no other form; what moves no cloth has no other.

    Args:
        tables: of these blocks and pixels.
        blocks, pixels, model: what was measured, and how likely it is.
    """
    still = [float(value.max()) for value in tables.nothing.blocks]
    return [
        tabulate(get_effect(table.name), blocks, pixels, model, still, as_simulated=True)
        if get_effect(table.name).moves_cloth
        else table
        for table in tables.effects
    ]


def _given(
    name: str,
    other: str,
    size: Mapping[str, float],
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
    nothing: Table,
) -> Table:
    """One effect where another of known size is there too; two of any form would fit any folds.

    ``blocks`` hold what the other scatters, if it does.
    """
    left = [without(block, other, size) for block in blocks]
    seen = [float(still.max()) for still in tabulate_nothing(left, pixels, model).blocks]
    if get_effect(other).moves_cloth:  # its response may have left the folds that are seen, too
        seen = [max(own, float(still.max())) for own, still in zip(seen, nothing.blocks, strict=True)]
    table = tabulate(get_effect(name), left, pixels_without(pixels, other, size), model, seen, as_simulated=True)
    if get_effect(name).moves_cloth or not get_effect(other).moves_cloth:
        return table
    return _or_without_the_other(table, blocks, pixels, model)


def _or_without_the_other(table: Table, blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Table:
    """Of an effect that moves no cloth beside one that does: in blocks whose folds may be those seen without the latter
    although the continued simulation left them, the first alone is what is seen.
    """
    effect = get_effect(table.name)
    if effect.vector:  # one size
        alone = tabulate_nothing([without(block, effect.name, table.sizes[0]) for block in blocks], pixels, model)
    else:  # of all scenes: what scatter counts for in one depends on whether there is another
        alone = tabulate(effect, blocks, pixels, model, as_simulated=True)
    same = zip(blocks, table.blocks, alone.blocks, strict=True)
    return replace(table, blocks=tuple(or_unmoved(b.scene, value, still, model) for b, value, still in same))
