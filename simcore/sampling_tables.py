"""Finite designs: a grid over the ranges, and the user's own list of fabrics."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError
from simcore.fabric_rows import read_rows
from simcore.parameters import PARAMETER_NAMES, FabricParameters
from simcore.prior import is_admissible


def grid_levels(count: int) -> tuple[int, ...]:
    """Levels along each of the seven axes of a full grid of at most ``count`` points, as even as can be.

    Raises:
        InputError: fewer than one point asked for.
    """
    if count < 1:
        raise InputError(f"a grid of {count} fabrics: give at least 1", code="grid_size")
    levels = [1] * len(PARAMETER_NAMES)
    while True:
        axis = int(np.argmin(levels))
        grown = [*levels[:axis], levels[axis] + 1, *levels[axis + 1 :]]
        if int(np.prod(grown)) > count:
            return tuple(levels)
        levels = grown


def log_grid(ranges: Mapping[str, tuple[float, float]], count: int) -> NDArray[np.float64]:
    """Admissible points of a full grid, at the centres of equal cells of each parameter's logarithm.

    Args:
        ranges: lowest and highest value of each parameter, SI.
        count: most points of the full grid; inadmissible ones are left out of the result.

    Returns:
        Fabric parameters, float64, shape [at most count, 7], last parameter fastest.

    Raises:
        InputError: fewer than one point asked for, or none of them admissible.
    """
    axes = [
        np.exp(np.log(ranges[name][0]) + (np.arange(n) + 0.5) / n * np.log(ranges[name][1] / ranges[name][0]))
        for name, n in zip(PARAMETER_NAMES, grid_levels(count), strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    grid = grid[is_admissible(grid)]
    if not len(grid):
        raise InputError(
            "no fabric of the grid has bendings that a plate can have: widen the ranges, or give the fabrics as a list",
            code="ranges_empty",
        )
    return np.asarray(grid, dtype=np.float64)


def read_fabric_list(path: str | Path) -> list[FabricParameters]:
    """Fabrics of a CSV or JSON file (:func:`simcore.fabric_rows.read_rows`); they need no ids.

    Raises:
        InputError: no such file, unreadable, empty, or a fabric that is unusable (its place in the file is named).
    """
    rows = read_rows(path)
    if not rows:
        raise InputError(f"{path}: holds no fabric", code="list_empty")
    return [_fabric(path, number, row) for number, row in enumerate(rows, start=1)]


def _fabric(path: str | Path, number: int, row: Any) -> FabricParameters:
    if not isinstance(row, Mapping):
        raise InputError(f"{path}, fabric {number}: no object, in a list of fabrics", code="list_form")
    try:
        return FabricParameters.from_mapping(row)
    except InputError as error:
        raise InputError(f"{path}, fabric {number}: {error}", code=error.code) from None
