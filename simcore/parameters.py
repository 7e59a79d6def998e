"""The seven fabric parameters: names, units, ranges, reading and checking."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError
from simcore.json_text import parse_json
from simcore.number import is_number

UNITS: dict[str, str] = {
    "stretch_warp": "N/m",
    "stretch_weft": "N/m",
    "stretch_bias": "N/m",
    "bending_warp": "N·m",
    "bending_weft": "N·m",
    "bending_bias": "N·m",
    "density": "kg/m²",
}
"""Unit of each parameter, in the order of every 7-vector in the project."""

PARAMETER_NAMES: tuple[str, ...] = tuple(UNITS)
ESTIMATED_NAMES: tuple[str, ...] = PARAMETER_NAMES[:6]
"""The six that the estimator gives; density is weighed."""

# What no textile exceeds; outside, a unit was mistaken (g/m² for kg/m², µN·m for N·m).
LIMITS: dict[str, tuple[float, float]] = {
    "stretch_warp": (1.0, 1e6),
    "stretch_weft": (1.0, 1e6),
    "stretch_bias": (0.5, 1e6),
    "bending_warp": (1e-8, 1e-1),
    "bending_weft": (1e-8, 1e-1),
    "bending_bias": (1e-8, 1e-1),
    "density": (5e-3, 5.0),
}


@dataclass(frozen=True)
class FabricParameters:
    """Mechanics of a fabric, SI (see ``docs/conventions.md``).

    Attributes:
        stretch_warp, stretch_weft, stretch_bias: membrane stiffness [N/m].
        bending_warp, bending_weft, bending_bias: flexural rigidity [N·m].
        density: area density [kg/m²].

    Raises:
        InputError: a value is not a finite number inside :data:`LIMITS`.
    """

    stretch_warp: float
    stretch_weft: float
    stretch_bias: float
    bending_warp: float
    bending_weft: float
    bending_bias: float
    density: float

    def __post_init__(self) -> None:
        for name in PARAMETER_NAMES:
            value = getattr(self, name)
            if not is_number(value):
                raise InputError(
                    f"{name} must be a number [{UNITS[name]}], got {value!r}", code="parameter_not_a_number"
                )
            try:
                value = float(value)
            except OverflowError:  # a whole number of hundreds of digits
                value = math.inf
            low, high = LIMITS[name]
            if not math.isfinite(value) or not low <= value <= high:
                raise InputError(
                    f"{name} = {value:g} {UNITS[name]} is outside {low:g} to {high:g} {UNITS[name]}: "
                    "give a positive, finite value in SI units",
                    code="parameter_out_of_range",
                )
            object.__setattr__(self, name, value)

    def as_array(self) -> NDArray[np.float64]:
        """Values in the order of :data:`PARAMETER_NAMES`, float64, shape [7]."""
        return np.array([getattr(self, n) for n in PARAMETER_NAMES], dtype=np.float64)

    def as_dict(self) -> dict[str, float]:
        """Name to value."""
        return asdict(self)

    @classmethod
    def from_array(cls, values: Any) -> FabricParameters:
        """From a 7-vector in the order of :data:`PARAMETER_NAMES`.

        Raises:
            InputError: not seven numbers, or out of range.
        """
        array = np.asarray(values, dtype=np.float64).ravel()
        if array.shape != (7,):
            raise InputError(f"seven fabric parameters are needed ({', '.join(PARAMETER_NAMES)}), got {array.size}")
        return cls(*(float(v) for v in array))

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> FabricParameters:
        """From names to numbers; other keys are ignored.

        Raises:
            InputError: a name is missing or a value is unusable.
        """
        missing = [n for n in PARAMETER_NAMES if values.get(n) is None]
        if missing:
            raise InputError(
                f"fabric parameters lack {', '.join(missing)}: all of {', '.join(PARAMETER_NAMES)} are needed",
                code="parameter_missing",
            )
        return cls(**{f.name: values[f.name] for f in fields(cls)})

    @classmethod
    def load(cls, path: str | Path) -> FabricParameters:
        """Read a JSON file with the seven numbers.

        Raises:
            InputError: no such file, not JSON, or unusable values.
        """
        values = read_json_object(path, "fabric parameters")
        try:
            return cls.from_mapping(values)
        except InputError as error:
            raise InputError(f"{path}: {error}", code=error.code) from None


def read_json_object(path: str | Path, what: str) -> dict[str, Any]:
    """Read a JSON object from a file.

    Args:
        path: the file.
        what: what it should hold, for the message.

    Raises:
        InputError: no such file, unreadable, not JSON or not an object.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the JSON file of the {what}", code="file_missing") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})", code="file_unreadable") from None
    value = parse_json(text, path)
    if not isinstance(value, dict):
        raise InputError(f"{path}: a JSON object with the {what} is needed", code="file_not_json")
    return value
