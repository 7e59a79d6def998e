"""An estimate as JSON, alike for the command line and the REST service."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from diagnosis.indirect_estimate import IndirectEstimate
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


def simulated_fields(found: IndirectEstimate) -> dict[str, Any]:
    """What simulations with the effects on said of one fabric, in plain values."""
    return {
        "without_effects": found.first.parameters,
        "left": round(found.left, 4),
        "simulations": found.simulations,
        "not_at_rest": found.unrested,
    }


def poses_note(in_poses: Sequence[str]) -> list[str]:
    """In words, which effects were not simulated for which captures (:func:`diagnosis.effects_in_poses.check_effects`);
    nothing where all were."""
    names = ", ".join(in_poses)
    return [f"{names}: not simulated where poses were found, which have it in them"] if in_poses else []
