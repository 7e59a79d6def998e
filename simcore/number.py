"""Whether what was given is a number, before it is compared with anything."""

from __future__ import annotations

import math
import reprlib
from typing import TypeGuard

import numpy as np

from simcore.errors import InputError


def is_number(value: object) -> TypeGuard[float]:
    """A whole or real number of Python's or NumPy's, finite or not; a truth value is none."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def is_finite(value: object) -> bool:
    """A number that a float holds and that is neither NaN nor infinite."""
    try:
        return is_number(value) and math.isfinite(value)
    except OverflowError:  # a whole number of hundreds of digits
        return False


def are_finite(values: object, count: int) -> bool:
    """A tuple, a list or an array of one dimension that holds so many finite numbers."""
    listed = isinstance(values, tuple | list) or (isinstance(values, np.ndarray) and values.ndim == 1)
    return listed and len(values) == count and all(is_finite(value) for value in values)  # type: ignore[arg-type,attr-defined]


def shown(value: object) -> str:
    """What was given, shortened and on one line, for a message."""
    if is_finite(value):
        return f"{value:g}"
    try:
        return " ".join(reprlib.repr(value).split())
    except ValueError:  # which Python writes out to some thousands of digits alone
        return "a whole number of too many digits"


def check_finite(what: str, value: object, code: str) -> None:
    """Refuse what is no finite number.

    Args:
        what: its name, with the unit where it has one, for the message.
        value: what was given.
        code: of the error.

    Raises:
        InputError: a text, None, a truth value, NaN, infinite or a whole number that no float holds.
    """
    if not is_number(value):
        raise InputError(f"{what} must be a number, got {shown(value)}", code=code)
    if not is_finite(value):
        raise InputError(f"{what} must be a finite number, got {shown(value)}", code=code)
