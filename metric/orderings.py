"""Orderings that are known beforehand: sweeps of one property, which a drape distance must find monotone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError
from simcore.parameters import PARAMETER_NAMES, FabricParameters

SWEPT: dict[str, tuple[str, ...]] = {
    "bending": ("bending_warp", "bending_weft", "bending_bias"),
    "stretch": ("stretch_warp", "stretch_weft", "stretch_bias"),
    "density": ("density",),
}
"""Sweeps and the parameters that grow together in each (the paper sweeps bending and stretch)."""

_BASE = {
    "stretch_warp": 200.0,
    "stretch_weft": 300.0,
    "stretch_bias": 60.0,
    "bending_warp": 1.3e-5,
    "bending_weft": 0.9e-5,
    "bending_bias": 1.1e-5,
    "density": 0.2,
}
_FACTORS = {"bending": 12.0, "stretch": 6.0, "density": 3.0}  # from the middle to either end, inside the prior's ranges


@dataclass(frozen=True)
class Sweep:
    """Fabrics in the order of one growing property.

    Attributes:
        name: of the property.
        fabrics: from the least to the most.
    """

    name: str
    fabrics: tuple[FabricParameters, ...]


def default_sweeps(steps: int = 6) -> list[Sweep]:
    """Sweeps of bending, stretch and density around a middling fabric, evenly spaced in the logarithm.

    Raises:
        InputError: fewer than 3 steps.
    """
    if steps < 3:
        raise InputError(f"a sweep needs at least 3 steps, got {steps}", code="sweep_too_short")
    return [
        Sweep(name, tuple(_scaled(names, factor) for factor in np.geomspace(1 / _FACTORS[name], _FACTORS[name], steps)))
        for name, names in SWEPT.items()
    ]


def monotone_share(distance: NDArray[np.float64]) -> float:
    """How monotone the distances along a sweep are.

    For every fabric as reference and every two others on the same side of it, the one further along the sweep must be
    further away; the share of such triples in which it is. 0.5 is chance; NaN of fewer than three fabrics, which have
    no such triple.

    Args:
        distance: between the fabrics of a sweep in order, shape [n, n].
    """
    count = len(distance)
    right, total = 0, 0
    for reference in range(count):
        for side in (range(reference - 1, -1, -1), range(reference + 1, count)):
            places: Sequence[int] = list(side)
            for k, near in enumerate(places):
                for far in places[k + 1 :]:
                    right += int(distance[reference, near] < distance[reference, far])
                    total += 1
    return right / total if total else float("nan")


def _scaled(names: Sequence[str], factor: float) -> FabricParameters:
    return FabricParameters(**{n: _BASE[n] * (factor if n in names else 1.0) for n in PARAMETER_NAMES})
