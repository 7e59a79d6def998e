"""JSON that somebody else wrote."""

from __future__ import annotations

import json
import math
from collections import Counter
from typing import Any

from simcore.errors import InputError


def parse_json(text: str, source: object) -> Any:
    """What a JSON text says.

    Args:
        text: the document.
        source: its name, for messages.

    Raises:
        InputError: not JSON, nested too deeply, a key twice in one object, or a number with thousands of digits.
    """

    def once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            twice, _ = next(item for item in Counter(key for key, _ in pairs).items() if item[1] > 1)
            raise InputError(f"{source}: {twice!r} is given twice in one object: give it once", code="file_key_twice")
        return found

    try:
        return json.loads(text, object_pairs_hook=once_each)
    except json.JSONDecodeError as error:
        raise InputError(f"{source}: not valid JSON (line {error.lineno}: {error.msg})", code="file_not_json") from None
    except RecursionError:
        raise InputError(f"{source}: not valid JSON (nested too deeply)", code="file_not_json") from None
    except ValueError:
        raise InputError(f"{source}: a number in it has too many digits to be read", code="file_not_json") from None


def whole(value: object) -> object:
    """A whole number written with a point, as JSON allows (640.0), without it; anything else as it is."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def first_not_finite(value: Any, place: str = "") -> str | None:
    """Where in a parsed document (`a.b[2]`) the first number is that is NaN or infinite, or None."""
    if isinstance(value, float):
        return None if math.isfinite(value) else place
    if isinstance(value, dict):
        children = [(f"{place}.{key}" if place else str(key), item) for key, item in value.items()]
    elif isinstance(value, list):
        children = [(f"{place}[{index}]", item) for index, item in enumerate(value)]
    else:
        return None
    return next((found for name, item in children if (found := first_not_finite(item, name)) is not None), None)
