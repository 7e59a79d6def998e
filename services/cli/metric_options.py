"""What the commands of the metric share."""

from __future__ import annotations


def check_resolution(resolution_m: float) -> None:
    """Refuse a resolution that does not cut the sample into whole cells, before anything is simulated.

    Raises:
        InputError: it does not.
    """
    from simcore.mesh import GridMesh

    GridMesh(resolution_m)


def unit_text(unit: str) -> str:
    """A unit as it follows a number."""
    return f" {unit}" if unit else ""
