"""What tests of two effects together are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from diagnosis.inference.evidence import Evidence
from diagnosis.simulation.responses import Responses


def evidence(name: str, value: float, size: Mapping[str, float] = {}) -> Evidence:
    return Evidence(name, value, value, {}, dict(size), dict(size), value, {})


@dataclass(frozen=True)
class Capture:
    """What of a capture's result is needed."""

    id: str
    responses: Responses
    reference: Any = None
