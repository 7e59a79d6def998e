"""Which materials are learnt from, calibrated on and tested on: always whole materials, never pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError

_SPLIT_STREAM = 1
LEAST_MATERIALS = 5
CALIBRATION_MATERIALS = 9
"""Fewer cannot promise a 90 % interval (see ``trainer.intervals``)."""


@dataclass(frozen=True)
class MaterialSplit:
    """Three disjoint sets of material numbers, each int64, sorted."""

    train: NDArray[np.int64]
    calibration: NDArray[np.int64]
    test: NDArray[np.int64]

    def without_known(self, known: Sequence[int]) -> MaterialSplit:
        """The same with materials that are known already learnt from again, in place of being held out.

        Raises:
            InputError: none are left to calibrate or to test on.
        """
        kept = [held[~np.isin(held, known)] for held in (self.calibration, self.test)]
        if not all(map(len, kept)):
            raise InputError(
                "the earlier model has learnt from the fabrics that would be held out: take a store with others, or "
                "the seed that it was trained with",
                code="start_knows_fabrics",
            )
        everything = np.concatenate([self.train, self.calibration, self.test])
        return MaterialSplit(np.sort(everything[~np.isin(everything, np.concatenate(kept))]), *kept)


def split_materials(
    materials: NDArray[np.int64], *, seed: int, train_share: float, calibration_share: float
) -> MaterialSplit:
    """Split the materials at random; the same seed and materials give the same split.

    Args:
        materials: material number of each row or material, any order, repeats allowed.

    Raises:
        InputError: too few materials for three sets.
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
    held_out = calibration + test
    return MaterialSplit(
        np.sort(shuffled[held_out:]), np.sort(shuffled[:calibration]), np.sort(shuffled[calibration:held_out])
    )
