"""Probabilities over the catalogue, ``none`` and ``unknown``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from diagnosis.block import Block, PixelBlock
from diagnosis.effects import get_effect
from diagnosis.evidence import Evidence, explain, explain_nothing, explain_unknown
from diagnosis.likelihood import LikelihoodModel

NOT_EFFECTS = ("none", "unknown")


@dataclass(frozen=True)
class CausePrior:
    """Probabilities before anything is seen; the rest is shared evenly by the effects."""

    none: float = 0.3
    unknown: float = 0.05


@dataclass(frozen=True)
class Cause:
    """What the captures say about the cause.

    Attributes:
        probabilities: explanation to probability; they sum to one.
        evidence: explanation to its evidence.
    """

    probabilities: Mapping[str, float]
    evidence: Mapping[str, Evidence]

    @property
    def top(self) -> str:
        """The most probable explanation."""
        return max(self.probabilities, key=lambda name: self.probabilities[name])


def name_cause(
    effects: Sequence[str],
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel = LikelihoodModel(),
    prior: CausePrior = CausePrior(),
) -> Cause:
    """Weigh all explanations against one another."""
    evidence = {"none": explain_nothing(blocks, pixels, model), "unknown": explain_unknown(blocks, pixels, model)}
    for name in effects:
        evidence[name] = explain(get_effect(name), blocks, pixels, model)
    share = (1.0 - prior.none - prior.unknown) / max(len(effects), 1)
    before = {"none": prior.none, "unknown": prior.unknown}
    weight = {name: e.log_evidence + np.log(before.get(name, share)) for name, e in evidence.items()}
    total = float(logsumexp(list(weight.values())))
    return Cause({name: float(np.exp(w - total)) for name, w in weight.items()}, evidence)
