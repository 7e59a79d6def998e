"""How magnets held the samples that a network learnt from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from capture.setup import DEFAULT_PIN_RADIUS_M


def held_in_training(provenance: Mapping[str, Any]) -> tuple[float, ...]:
    """What they held round a corner [m], nominal where a store says nothing.

    Of each of the sweeps that a model learnt from, merged or not, and of those of the model that it goes on from.

    Args:
        provenance: of a model (:attr:`trainer.model.TrainedModel.provenance`).
    """
    return tuple(sorted(set(_learnt(provenance))))


def _learnt(provenance: Mapping[str, Any]) -> list[float]:
    configuration = (provenance.get("data") or {}).get("configuration") or {}
    earlier = (provenance.get("start") or {}).get("provenance")
    return [*_radii(configuration), *(_learnt(earlier) if earlier is not None else ())]


def _radii(configuration: Mapping[str, Any]) -> list[float]:
    merged = configuration.get("merged", ())
    if merged:
        return [radius for one in merged for radius in _radii(one)]
    stated = configuration.get("pin_radius_m")
    return [DEFAULT_PIN_RADIUS_M if stated is None else float(stated)]
