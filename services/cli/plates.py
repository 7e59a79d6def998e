"""What is said of a fabric whose stated bendings no elastic plate can have."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

from services import console
from simcore.bending import raised_biases
from simcore.parameters import FabricParameters

MOST_NAMED = 5
"""Fabrics that are told one by one."""


def note_raised_bias(fabrics: Iterable[tuple[str, FabricParameters]]) -> dict[str, str]:
    """Say on standard error which fabrics are simulated with a larger ``bending_bias`` than stated, and with which.

    Args:
        fabrics: name and parameters of each.

    Returns:
        What is said of each of them, by name, for a document.
    """
    raised = raised_biases(fabrics)
    for name, said in islice(raised.items(), MOST_NAMED):
        console.note(f"{name}: {said}")
    if len(raised) > MOST_NAMED:
        console.note(f"the same goes for {len(raised) - MOST_NAMED} more fabrics")
    return raised
