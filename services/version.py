"""The installed version."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def software_version() -> str:
    """Version of the distribution, or ``0+source`` from a bare source tree."""
    try:
        return version("drapemeter")
    except PackageNotFoundError:
        return "0+source"
