"""A library of fabrics: id and seven numbers each, from JSON or CSV."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simcore.csv_text import parse_csv, parse_number
from simcore.errors import InputError
from simcore.json_text import parse_json
from simcore.parameters import PARAMETER_NAMES, FabricParameters


@dataclass(frozen=True)
class LibraryFabric:
    """One entry of a library.

    Attributes:
        id: unique name.
        parameters: the seven numbers.
    """

    id: str
    parameters: FabricParameters


def load_library(path: str | Path) -> list[LibraryFabric]:
    """Read a library.

    JSON: a list of objects with ``id`` and the seven numbers (flat or under ``parameters``), an object with such a list
    under ``fabrics``, or an object that maps ids to such objects. CSV (by suffix): a header with ``id`` and the seven
    names.

    Raises:
        InputError: no such file, not readable, no fabrics, an id missing or twice, unusable numbers.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the JSON or CSV library", code="file_missing") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})", code="file_unreadable") from None
    rows = _csv_rows(text, path) if path.suffix.lower() == ".csv" else _json_rows(text, path)
    return parse_library(rows, str(path))


def parse_library(rows: Iterable[Any], where: str) -> list[LibraryFabric]:
    """Library entries from mappings with ``id`` and the seven numbers.

    Args:
        rows: the entries.
        where: what they were read from, for messages.

    Raises:
        InputError: no fabrics, an id missing or twice, unusable numbers.
    """
    fabrics: dict[str, LibraryFabric] = {}
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, Mapping) or row.get("id") in (None, ""):
            raise InputError(f"{where}: fabric {number} has no id", code="library_id_missing")
        fabric_id = str(row["id"])
        if any("\ud800" <= letter <= "\udfff" for letter in fabric_id):
            raise InputError(
                f"{where}: the id of fabric {number} holds half a character (\\ud800 to \\udfff): write it whole",
                code="library_id",
            )
        if fabric_id in fabrics:
            raise InputError(f"{where}: the id {fabric_id!r} occurs twice; ids must differ", code="library_id_twice")
        nested = row.get("parameters")
        values = {**row, **nested} if isinstance(nested, Mapping) else row
        try:
            parameters = FabricParameters.from_mapping(values)
        except InputError as error:
            raise InputError(f"{where}: fabric {fabric_id!r}: {error}", code=error.code) from None
        fabrics[fabric_id] = LibraryFabric(fabric_id, parameters)
    if not fabrics:
        raise InputError(f"{where}: the library holds no fabrics", code="library_empty")
    return list(fabrics.values())


def _json_rows(text: str, path: Path) -> list[Any]:
    value = parse_json(text, path)
    if isinstance(value, Mapping):
        inner = value.get("fabrics", value)
        if isinstance(inner, Mapping):
            return [{"id": key, **row} if isinstance(row, Mapping) else row for key, row in inner.items()]
        value = inner
    if not isinstance(value, list):
        raise InputError(
            f"{path}: a list of fabrics (objects with id and the seven numbers) is needed", code="library_form"
        )
    return value


def _csv_rows(text: str, path: Path) -> list[dict[str, Any]]:
    header, records = parse_csv(text, path)
    missing = [n for n in ("id", *PARAMETER_NAMES) if n not in header]
    if missing:
        raise InputError(f"{path}: the header lacks {', '.join(missing)}", code="library_header")
    rows: list[dict[str, Any]] = []
    for row in records:
        numbers: dict[str, Any] = {"id": row["id"]}
        for name in PARAMETER_NAMES:
            numbers[name] = parse_number(row[name])
            if numbers[name] is None:
                raise InputError(
                    f"{path}: fabric {row['id']!r}: {name} is not a number ({row[name]!r})",
                    code="parameter_not_a_number",
                )
        rows.append(numbers)
    return rows
