"""How magnets held the samples that a network learnt from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from capture.setup import DEFAULT_PIN_RADIUS_M


def held_in_training(provenance: Mapping[str, Any]) -> tuple[float, ...]:
    """What they held round a corner [m]: of each of the sweeps that a model's store was merged from; nominal where the
    store says nothing.

    Args:
        provenance: of a model (:attr:`trainer.model.TrainedModel.provenance`).
    """
    configuration = (provenance.get("data") or {}).get("configuration") or {}
    return tuple(sorted(set(_radii(configuration))))


def _radii(configuration: Mapping[str, Any]) -> list[float]:
    merged = configuration.get("merged", ())
    if merged:
        return [radius for one in merged for radius in _radii(one)]
    stated = configuration.get("pin_radius_m")
    return [DEFAULT_PIN_RADIUS_M if stated is None else float(stated)]
