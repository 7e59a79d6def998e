"""Tables as text: what a spreadsheet writes, read without guessing."""

from __future__ import annotations

import csv
import io

from simcore.errors import InputError

_OTHER_SEPARATORS = {";": "semicolons", "\t": "tabs"}
"""What spreadsheets write between cells where not a comma."""


def parse_csv(text: str, source: object) -> tuple[list[str], list[dict[str, str]]]:
    """Header and rows of a CSV table; lines of nothing but empty cells are passed over, cells a row lacks are empty.

    Args:
        text: the table, its first line the header.
        source: its name, for messages.

    Raises:
        InputError: a quotation mark that is not closed, columns that no commas separate, a column named twice, or a row
            with more cells than the header.
    """
    _refuse_other_separators(text, source)
    try:
        read = csv.reader(io.StringIO(text, newline=""), strict=True)
        lines = [line for line in read if any(cell.strip() for cell in line)]
    except csv.Error as error:
        raise InputError(
            f"{source}: no CSV table ({error}): close every quotation mark, one line a row", code="csv_form"
        ) from None
    header = [name.strip() for name in lines[0]] if lines else []
    twice = next((name for name in header if name and header.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{source}: the column {twice} occurs twice: leave one", code="csv_column_twice")
    rows = []
    for number, line in enumerate(lines[1:], start=1):
        if any(cell.strip() for cell in line[len(header) :]):
            raise InputError(
                f"{source}: row {number} has {len(line)} cells where the header has {len(header)}: write numbers with "
                "a point, not a comma, and quote texts that have commas in them",
                code="csv_cells",
            )
        rows.append(dict(zip(header, [*line, *[""] * len(header)], strict=False)))
    return header, rows


def _refuse_other_separators(text: str, source: object) -> None:
    """Tell a header of several names without a comma, which would be read as one name.

    Raises:
        InputError: semicolons or tabs separate its names.
    """
    header = text.strip("\r\n").partition("\n")[0]
    found = [name for mark, name in _OTHER_SEPARATORS.items() if mark in header]
    if found and "," not in header:
        raise InputError(
            f"{source}: {found[0]} stand between the columns: separate columns with commas, and write numbers with a "
            "point, not a comma",
            code="csv_separator",
        )


def parse_number(cell: str) -> float | None:
    """The number in a cell, or None where there is none."""
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None
