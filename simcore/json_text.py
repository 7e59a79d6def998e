"""JSON that somebody else wrote."""

from __future__ import annotations

import json
from typing import Any

from simcore.errors import InputError


def parse_json(text: str, source: object) -> Any:
    """What a JSON text says.

    Args:
        text: the document.
        source: its name, for messages.

    Raises:
        InputError: not JSON, nested too deeply, or a number with thousands of digits.
    """
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{source}: not valid JSON (line {error.lineno}: {error.msg})", code="file_not_json") from None
    except RecursionError:
        raise InputError(f"{source}: not valid JSON (nested too deeply)", code="file_not_json") from None
    except ValueError:
        raise InputError(f"{source}: a number in it has too many digits to be read", code="file_not_json") from None
