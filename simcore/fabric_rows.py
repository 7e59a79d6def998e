"""Lists of fabrics as people write them down: rows of a CSV or JSON file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from simcore.csv_text import parse_csv, parse_number
from simcore.errors import InputError
from simcore.json_text import parse_json
from simcore.parameters import PARAMETER_NAMES


def read_rows(path: str | Path) -> list[Any]:
    """The rows of a list of fabrics, the seven numbers beside the ``id``, where there is one.

    CSV (by suffix): a header with the seven names and, if wanted, ``id``; empty cells are left out. JSON: a list of
    objects, an object with such a list under ``fabrics``, or one that maps ids to such objects; numbers may also stand
    under ``parameters``, as in a capture set. Other columns and keys are passed on or over; nothing else is checked.

    Raises:
        InputError: no such file, not readable, or not of these forms.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give a CSV or JSON list of fabrics", code="file_missing") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})", code="file_unreadable") from None
    return _csv_rows(text, path) if file.suffix.lower() == ".csv" else _json_rows(text, path)


def _csv_rows(text: str, path: str | Path) -> list[Any]:
    _, records = parse_csv(text, path)
    rows: list[Any] = []
    for record in records:
        row: dict[str, Any] = {"id": record["id"]} if "id" in record else {}
        for name in PARAMETER_NAMES:
            if cell := record.get(name):
                number = parse_number(cell)
                row[name] = cell if number is None else number  # whoever reads the row says what it is of
        rows.append(row)
    return rows


def _json_rows(text: str, path: str | Path) -> list[Any]:
    value = parse_json(text, path)
    if isinstance(value, Mapping):
        value = value.get("fabrics", value)
    if isinstance(value, Mapping):
        value = [{"id": key, **row} if isinstance(row, Mapping) else row for key, row in value.items()]
    if not isinstance(value, list):
        raise InputError(
            f'{path}: a list of fabrics, {{"fabrics": [...]}}, or an object of ids and fabrics is needed',
            code="list_form",
        )
    return [flat(row) for row in value]


def flat(row: Any) -> Any:
    """A row with what stands under ``parameters`` beside the rest."""
    nested = row.get("parameters") if isinstance(row, Mapping) else None
    return {**row, **nested} if isinstance(nested, Mapping) else row
