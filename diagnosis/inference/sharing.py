"""The probability of two effects together is shared by the two."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.special import logsumexp

from diagnosis.inference.pairs import Pair

FIRST_SHARE = 0.501
"""Of a pair's probability, its first effect's."""


def share_of(one: Pair, pairs: Sequence[Pair], log_weights: Sequence[float]) -> float:
    """Of all pairs' probability, that of one and of those in which declared twins stand for its effects.

    Args:
        one: of the pairs.
        pairs: all of them.
        log_weights: of each, log of its probability, from any origin.
    """
    own = [weight for pair, weight in zip(pairs, log_weights, strict=True) if pair.is_as(one)]
    return float(np.exp(logsumexp(own) - logsumexp(log_weights)))


def best_pair(pairs: Sequence[Pair], log_weights: Sequence[float]) -> Pair:
    """The most probable of those two effects, declared twins of theirs counted with them, that are most probable."""
    both = [(share_of(pair, pairs, log_weights), own) for pair, own in zip(pairs, log_weights, strict=True)]
    return pairs[max(range(len(pairs)), key=both.__getitem__)]


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
        best = best_pair(pairs, np.log(np.array(two) + 1e-300).tolist())
        masses = {name: _mass(name, pairs, two) for name in (best.first, best.second)}
        preferred = max(masses, key=lambda name: masses[name])
        others = _halves(
            alone, [(p, v) for p, v in zip(pairs, two, strict=True) if preferred not in (p.first, p.second)]
        )
        share = min(1.0, max(FIRST_SHARE, *_needed(preferred, others, pairs, two)))
    found = dict(alone)
    for pair, p in zip(pairs, two, strict=True):
        first, second = (pair.second, pair.first) if pair.second == preferred else (pair.first, pair.second)
        own = share if first == preferred else FIRST_SHARE
        found[first] += own * p
        found[second] += (1.0 - own) * p
    return found


def _halves(alone: Mapping[str, float], pairs: Sequence[tuple[Pair, float]]) -> dict[str, float]:
    """Probabilities alone and of some pairs, these in halves."""
    found = dict(alone)
    for pair, p in pairs:
        found[pair.first] += FIRST_SHARE * p
        found[pair.second] += (1.0 - FIRST_SHARE) * p
    return found


def _needed(
    preferred: str, others: Mapping[str, float], pairs: Sequence[Pair], two: Sequence[float]
) -> Iterator[float]:
    """Of all its pairs, the share with which an effect is a little more probable than each other explanation.

    ``others``: each one's probability without what it shares with the preferred one.
    """
    a_little, own = FIRST_SHARE / 0.5, _mass(preferred, pairs, two)
    for name, rest in others.items():
        if name != preferred:
            common = sum(p for q, p in zip(pairs, two, strict=True) if {q.first, q.second} == {name, preferred})
            yield (a_little * (rest + common) - others[preferred]) / (own + a_little * common)


def _mass(name: str, pairs: Sequence[Pair], two: Sequence[float]) -> float:
    """Probability of all pairs that an effect is one of."""
    return sum(p for pair, p in zip(pairs, two, strict=True) if name in (pair.first, pair.second))
