"""What makes two trainings the same, so that one may go on where the other was interrupted."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import fields
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trainer.config import TrainConfig
from trainer.dataset import PictureTable
from trainer.split import MaterialSplit

TRAINING_VERSION = 1
"""Raised when a training computes otherwise, be it in the last bits: one that was begun with another is refused."""
LIBRARIES = ("torch", "torchvision", "kornia", "numpy")
"""Whose versions decide what a step computes."""


def description(
    config: TrainConfig, table: PictureTable, split: MaterialSplit, record: Mapping[str, Any]
) -> dict[str, str]:
    """All that decides what a training comes to, by name: options as they are, the rest as versions and short hashes.

    Args:
        config: the run's, as it is learnt with.
        table: every usable picture.
        split: of the materials.
        record: the model's provenance: what the stores say of themselves, the earlier model, weights begun with.
    """
    start = record.get("start")
    return {
        **dict(_options(config.to_json())),
        "stores": _text_hash(record["data"]),
        "pictures": _array_hash({one.name: getattr(table, one.name) for one in fields(table)}),
        "split": _array_hash({one.name: getattr(split, one.name) for one in fields(split)}),
        "start": start["model_version"] if start else "none",
        "ImageNet weights": _text_hash(record["base_weights"]),
        "program": str(TRAINING_VERSION),
        **{name: version(name) for name in LIBRARIES},
    }


def _options(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Names with dots and JSON values of all fields, also those of configurations within."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _options(value, f"{prefix}{name}.")
        else:
            yield prefix + name, json.dumps(value)


def _text_hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:12]


def _array_hash(arrays: Mapping[str, NDArray[Any]]) -> str:
    digest = hashlib.sha256()
    for name, array in arrays.items():
        digest.update(f"{name} {array.dtype} {array.shape}\n".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:12]
