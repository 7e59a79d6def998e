"""Whether a store's scenes are the same in the mirror, so that mirrored pictures may be learnt from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from trainer.config import TrainConfig


def as_symmetric(config: TrainConfig, provenance: Mapping[str, Any]) -> TrainConfig:
    """The configuration without mirroring, where the store was made by an extended simulator.

    The baseline's ``hanging`` is symmetric. A lowered pin, turned yarns or a crease are not, and mirrored pictures
    would show the opposite of what the simulator was extended by.

    Args:
        config: as asked for.
        provenance: what the store says of itself (:meth:`trainer.store_source.StoreSource.provenance`).
    """
    return config if is_symmetric(provenance) or not config.mirror else replace(config, mirror=0.0)


def is_symmetric(provenance: Mapping[str, Any]) -> bool:
    """Whether a store was made by the baseline alone; see :func:`as_symmetric`."""
    return not _is_extended(provenance.get("configuration") or {})


def _is_extended(configuration: Mapping[str, Any]) -> bool:
    """A sweep's simulator has effects, or that of one of the stores it was merged from."""
    return bool(configuration.get("simulator")) or any(map(_is_extended, configuration.get("merged", ())))
