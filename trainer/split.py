"""Which materials are learnt from, calibrated on and tested on: always whole materials, never pictures."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError

_SPLIT_STREAM = 1
LEAST_MATERIALS = 5
CALIBRATION_MATERIALS = 9
"""Fewer cannot promise a 90 % interval (see ``trainer.intervals``)."""
LEAST_HELD_OUT = 2
"""One to calibrate and one to test on."""


@dataclass(frozen=True)
class MaterialSplit:
    """Three disjoint sets of material numbers, each int64, sorted."""

    train: NDArray[np.int64]
    calibration: NDArray[np.int64]
    test: NDArray[np.int64]


def split_materials(
    materials: NDArray[np.int64],
    *,
    seed: int,
    train_share: float,
    calibration_share: float,
    known: Collection[int] = (),
) -> MaterialSplit:
    """Split the materials at random; the same seed and materials give the same split.

    Args:
        materials: material number of each row or material, any order, repeats allowed.
        seed: of the split.
        train_share, calibration_share: of the materials; the rest is tested on.
        known: materials that an earlier model has learnt from: they are not held out. Where fewer others are left than
            would be, both held-out sets are smaller.

    Raises:
        InputError: too few materials for three sets, or too few that are not known.
    """
    unique = np.unique(materials)
    if len(unique) < LEAST_MATERIALS:
        raise InputError(
            f"the store has usable pictures of {len(unique)} materials, at least {LEAST_MATERIALS} are needed to "
            "train, calibrate and test on different ones: make a larger store",
            code="too_few_materials",
        )
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_SPLIT_STREAM,)))
    shuffled = generator.permutation(unique)
    # A small store gives a fifth of its materials rather than intervals that promise nothing.
    calibration = max(1, round(calibration_share * len(unique)), min(CALIBRATION_MATERIALS, len(unique) // 5))
    test = max(1, round((1.0 - train_share - calibration_share) * len(unique)))
    is_known = np.isin(shuffled, np.array(sorted(known), dtype=np.int64))
    left = int((~is_known).sum())
    if left < LEAST_HELD_OUT:
        raise InputError(
            f"the earlier model has learnt from all but {left} of the store's {len(unique)} fabrics, and those that it "
            "knows cannot be held out: take a store with others",
            code="start_knows_fabrics",
        )
    if left < calibration + test:
        calibration = min(left - 1, max(1, round(left * calibration / (calibration + test))))
        test = left - calibration
    held_out = calibration + test
    shuffled = np.concatenate([shuffled[~is_known], shuffled[is_known]])
    return MaterialSplit(
        np.sort(shuffled[held_out:]), np.sort(shuffled[:calibration]), np.sort(shuffled[calibration:held_out])
    )
