"""An estimate as JSON, alike for the command line and the REST service."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trainer.predict import Estimate


def estimate_fields(found: Estimate, notes: Sequence[str]) -> dict[str, Any]:
    """What an estimate says of one fabric, in plain values; a score that is not finite becomes None.

    Args:
        found: the estimate.
        notes: in words, what speaks against the poses of its captures (:class:`capture.pose_notes.PoseNotes`).
    """
    score = found.out_of_distribution_score
    return {
        "parameters": found.parameters,
        "intervals_90": {name: list(ends) for name, ends in found.intervals_90.items()},
        "intervals_calibrated": found.intervals_calibrated,
        "out_of_distribution": found.out_of_distribution,
        "out_of_distribution_score": score if math.isfinite(score) else None,
        "out_of_distribution_reasons": list(found.reasons),
        "scenes": list(found.scenes),
        "notes": list(notes),
    }
