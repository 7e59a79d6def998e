"""Versions: of the distribution, and of the data it makes."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from simcore.version import SOLVER_VERSION


def software_version() -> str:
    """Version of the distribution, or ``0+source`` from a bare source tree."""
    try:
        return version("drapemeter")
    except PackageNotFoundError:
        return "0+source"


def data_version() -> str:
    """What a store states: the distribution's version with the solver's, whose results may change between releases."""
    return f"{software_version()}+solver{SOLVER_VERSION}"
