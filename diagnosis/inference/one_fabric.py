"""What one fabric alone may say for or against an explanation."""

from __future__ import annotations

from dataclasses import replace

from diagnosis.effects import get_effect
from diagnosis.groups import NOT_EFFECTS
from diagnosis.inference.evidence import Evidence
from diagnosis.inference.likelihood import ALONE_NATS

LOST_ALONE_NATS = 3.0
"""An effect on the cloth may lose so much more by one fabric than by any other, of three or more: that one of twenty
fabrics is off for a reason of its own."""


def by_more_than_one(found: Evidence, other: Evidence) -> Evidence:
    """Without what one fabric alone would gain against another explanation, or lose by an effect on the cloth.

    Its folds may be found by chance with an effect on and missed without, or the other way round, and its parameters
    may be wrong: what is common to all fabrics shows in two.
    """
    gains = sorted(found.by_fabric[fabric] - other.by_fabric[fabric] for fabric in found.by_fabric)
    if len(gains) < 2:
        return found
    excess = max(0.0, gains[-1] - max(gains[-2], 0.0) - ALONE_NATS)
    if len(gains) > 2 and found.name not in NOT_EFFECTS and get_effect(found.name).moves_cloth:
        excess -= max(0.0, min(gains[1], 0.0) - gains[0] - LOST_ALONE_NATS)
    return replace(found, log_evidence=found.log_evidence - excess, best=found.best - excess)
