"""A library of fabrics: id and seven numbers each, from JSON or CSV."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simcore.errors import InputError
from simcore.fabric_rows import flat, read_rows
from simcore.parameters import FabricParameters


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
    """Read a library, CSV or JSON (:func:`simcore.fabric_rows.read_rows`); every fabric has an id.

    Raises:
        InputError: no such file, not readable, a column missing, no fabrics, an id missing or twice, unusable numbers.
    """
    return parse_library(read_rows(path, with_ids=True), str(path))


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
        try:
            parameters = FabricParameters.from_mapping(flat(row))
        except InputError as error:
            raise InputError(f"{where}: fabric {fabric_id!r}: {error}", code=error.code) from None
        fabrics[fabric_id] = LibraryFabric(fabric_id, parameters)
    if not fabrics:
        raise InputError(f"{where}: the library holds no fabrics", code="library_empty")
    return list(fabrics.values())
