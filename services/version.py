"""Versions: of the distribution, and of the data it makes."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from simcore.version import BATCH_VERSION, PRIOR_VERSION, SOLVER_VERSION


def software_version() -> str:
    """Version of the distribution, or ``0+source`` from a bare source tree."""
    try:
        return version("drapemeter")
    except PackageNotFoundError:
        return "0+source"


def data_version(*, batch: bool = False, drawn: bool = False) -> str:
    """What a store states: the distribution's version with those of what may change between releases.

    Args:
        batch: its drapes are the batch solver's, which has a version of its own beside the solver's.
        drawn: its fabrics are drawn from the prior.
    """
    versions = {"solver": SOLVER_VERSION}
    if batch:
        versions["batch"] = BATCH_VERSION
    if drawn:
        versions["prior"] = PRIOR_VERSION
    return f"{software_version()}+{'.'.join(f'{name}{number}' for name, number in versions.items())}"
