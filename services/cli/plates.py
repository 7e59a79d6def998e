"""What is said of a fabric whose stated bendings no elastic plate can have."""

from __future__ import annotations

from collections.abc import Iterable

from services import console
from simcore.bending import PlateRigidity
from simcore.parameters import FabricParameters

MOST_NAMED = 5
"""Fabrics that are told one by one."""


def note_raised_bias(fabrics: Iterable[tuple[str, FabricParameters]]) -> None:
    """Say on standard error which fabrics are simulated with a larger ``bending_bias`` than stated, and with which.

    Args:
        fabrics: name and parameters of each.
    """
    raised = [(name, fabric) for name, fabric in fabrics if PlateRigidity.of(fabric).bias_raised]
    for name, fabric in raised[:MOST_NAMED]:
        console.note(
            f"{name}: no plate with its bending_warp and bending_weft has a bending_bias of {fabric.bending_bias:.3g} "
            f"N·m; simulated with {PlateRigidity.of(fabric).bias:.3g} N·m, the least there is"
        )
    if len(raised) > MOST_NAMED:
        console.note(f"the same goes for {len(raised) - MOST_NAMED} more fabrics")
