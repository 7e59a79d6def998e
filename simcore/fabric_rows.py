"""Lists of fabrics as people write them down: rows of a CSV or JSON file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from simcore.csv_text import parse_csv, parse_number
from simcore.errors import InputError
from simcore.json_text import parse_json
from simcore.parameters import PARAMETER_NAMES


def read_rows(path: str | Path, *, with_ids: bool = False) -> list[Any]:
    """The rows of a list of fabrics, the seven numbers beside the ``id``, where there is one.

    CSV (by suffix): a header with the seven names and, if wanted, ``id``; empty cells are left out. JSON: a list of
    objects, an object with such a list under ``fabrics``, or one that maps ids to such objects; numbers may also stand
    under ``parameters``, as in a capture set. Other columns and keys are passed on or over; nothing else is checked.

    Args:
        path: the file.
        with_ids: refuse a header without ``id``, too.

    Raises:
        InputError: no such file, not readable, not of these forms, a column missing, or two ids of one fabric.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give a CSV or JSON list of fabrics", code="file_missing") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})", code="file_unreadable") from None
    return _csv_rows(text, path, with_ids) if file.suffix.lower() == ".csv" else _json_rows(text, path)


def _csv_rows(text: str, path: str | Path, with_ids: bool) -> list[Any]:
    header, records = parse_csv(text, path)
    if header:
        _refuse_missing_columns(header, path, with_ids)
    rows: list[Any] = []
    for record in records:
        row: dict[str, Any] = {"id": record["id"]} if "id" in record else {}
        for name in PARAMETER_NAMES:
            if cell := record.get(name):
                number = parse_number(cell)
                row[name] = cell if number is None else number  # whoever reads the row says what it is of
        rows.append(row)
    return rows


def _refuse_missing_columns(header: list[str], path: str | Path, with_ids: bool) -> None:
    """Name the columns that a header lacks beside those that were read.

    Raises:
        InputError: it lacks one of the seven numbers, or ``id`` where fabrics need one.
    """
    read = ", ".join(filter(None, header))
    missing = [name for name in PARAMETER_NAMES if name not in header]
    if missing:
        raise InputError(
            f"{path}: no column is named {', '.join(missing)}; the columns are {read}: name them just so in the header",
            code="parameter_missing",
        )
    if with_ids and "id" not in header:
        raise InputError(
            f"{path}: no column is named id; the columns are {read}: name the one that holds the fabrics' ids just so",
            code="library_id_missing",
        )


def _json_rows(text: str, path: str | Path) -> list[Any]:
    value = parse_json(text, path)
    if isinstance(value, Mapping):
        value = value.get("fabrics", value)
    if isinstance(value, Mapping):
        return [_named(key, flat(row), path) for key, row in value.items()]
    if not isinstance(value, list):
        raise InputError(
            f'{path}: a list of fabrics, {{"fabrics": [...]}}, or an object of ids and fabrics is needed',
            code="list_form",
        )
    return [flat(row) for row in value]


def _named(key: str, row: Any, path: str | Path) -> Any:
    """A fabric with the key that it stands under as its id.

    Raises:
        InputError: it states another id itself.
    """
    if not isinstance(row, Mapping):
        return row
    own = row.get("id")
    if own is not None and str(own) != key:
        raise InputError(
            f"{path}: the fabric under {key!r} has the id {own!r}: leave its id out, or write the key alike",
            code="library_id_differs",
        )
    return {**row, "id": key}


def flat(row: Any) -> Any:
    """A row with what stands under ``parameters`` beside the rest."""
    nested = row.get("parameters") if isinstance(row, Mapping) else None
    return {**row, **nested} if isinstance(nested, Mapping) else row
