"""Finite designs: a grid over the ranges, and the user's own list of fabrics."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.csv_text import parse_csv, parse_number
from simcore.errors import InputError
from simcore.json_text import parse_json
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
    """
    axes = [
        np.exp(np.log(ranges[name][0]) + (np.arange(n) + 0.5) / n * np.log(ranges[name][1] / ranges[name][0]))
        for name, n in zip(PARAMETER_NAMES, grid_levels(count), strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    return np.asarray(grid[is_admissible(grid)], dtype=np.float64)


def read_fabric_list(path: str | Path) -> list[FabricParameters]:
    """Fabrics of a CSV file (a header with the seven names) or a JSON file (a list, or ``{"fabrics": [...]}``).

    Other columns and keys are ignored. In JSON the seven numbers may also stand under ``"parameters"`` with the density
    beside it, as in a capture set.

    Raises:
        InputError: no such file, unreadable, empty, or a fabric that is unusable (its place in the file is named).
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give a CSV or JSON list of fabrics", code="file_missing") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})", code="file_unreadable") from None
    rows = _csv_rows(text, path) if file.suffix.lower() == ".csv" else _json_rows(path, text)
    if not rows:
        raise InputError(f"{path}: holds no fabric", code="list_empty")
    return [_fabric(path, number, row) for number, row in enumerate(rows, start=1)]


def _csv_rows(text: str, path: str | Path) -> list[dict[str, Any]]:
    _, records = parse_csv(text, path)
    rows: list[dict[str, Any]] = []
    for record in records:
        cells = {name: record.get(name) or None for name in PARAMETER_NAMES}
        numbers = {name: None if cell is None else parse_number(cell) for name, cell in cells.items()}
        rows.append({name: cells[name] if numbers[name] is None else numbers[name] for name in PARAMETER_NAMES})
    return rows


def _json_rows(path: str | Path, text: str) -> list[dict[str, Any]]:
    value = parse_json(text, path)
    rows = value.get("fabrics") if isinstance(value, dict) else value
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f'{path}: a list of fabrics, or {{"fabrics": [...]}}, is needed', code="list_form")
    return [{**row, **row["parameters"]} if isinstance(row.get("parameters"), dict) else row for row in rows]


def _fabric(path: str | Path, number: int, row: Mapping[str, Any]) -> FabricParameters:
    try:
        return FabricParameters.from_mapping(row)
    except InputError as error:
        raise InputError(f"{path}, fabric {number}: {error}", code=error.code) from None
