"""Probabilities over the catalogue, ``none`` and ``unknown``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from diagnosis.effects import get_effect
from diagnosis.evidence import (
    EffectEvidence,
    EvidenceModel,
    explain_nothing,
    explain_scalar,
    explain_unknown,
    explain_vector,
)
from diagnosis.noise import Block, PixelBlock


@dataclass(frozen=True)
class Cause:
    """What the captures say about the cause.

    Attributes:
        probabilities: explanation to probability; they sum to one.
        evidence: explanation to its evidence.
    """

    probabilities: Mapping[str, float]
    evidence: Mapping[str, EffectEvidence]

    @property
    def top(self) -> str:
        """The most probable explanation."""
        return max(self.probabilities, key=lambda name: self.probabilities[name])


def name_cause(
    effects: tuple[str, ...], blocks: list[Block], pixels: PixelBlock, model: EvidenceModel = EvidenceModel()
) -> Cause:
    """Weigh all explanations against one another."""
    evidence = {"none": explain_nothing(blocks, pixels, model), "unknown": explain_unknown(blocks, pixels, model)}
    for name in effects:
        effect = get_effect(name)
        explain = explain_vector if effect.vector else explain_scalar
        evidence[name] = explain(effect, blocks, pixels, model)
    share = (1.0 - model.none_prior) / max(len(effects) + 1, 1)
    log_weight = {
        name: e.log_evidence + np.log(model.none_prior if name == "none" else share) for name, e in evidence.items()
    }
    total = float(logsumexp(list(log_weight.values())))
    return Cause({name: float(np.exp(w - total)) for name, w in log_weight.items()}, evidence)
