"""What an API key may do."""

from __future__ import annotations

from enum import StrEnum

from services.names import split_names
from simcore.errors import InputError


class ApiScope(StrEnum):
    """One permission."""

    ESTIMATES_WRITE = "estimates:write"
    DISTANCES_WRITE = "distances:write"
    FABRICS_READ = "fabrics:read"
    FABRICS_WRITE = "fabrics:write"
    DIAGNOSES_WRITE = "diagnoses:write"
    DATASETS_WRITE = "datasets:write"
    JOBS_READ = "jobs:read"
    JOBS_WRITE = "jobs:write"
    METRICS_READ = "metrics:read"


def parse_scopes(text: str) -> tuple[ApiScope, ...]:
    """Scopes from a comma-separated list; ``*`` is all of them.

    Raises:
        InputError: an unknown scope, none, or ``*`` beside others.
    """
    names = split_names(text)
    if names == ("*",):
        return tuple(ApiScope)
    if "*" in names:
        raise InputError("* stands alone: give nothing beside it, or name scopes without it", code="scope_unknown")
    known = {scope.value for scope in ApiScope}
    unknown = sorted(set(names) - known)
    if unknown or not names:
        what = f"unknown scope {unknown[0]!r}" if unknown else "no scope given"
        raise InputError(f"{what}: choose from {', '.join(sorted(known))}, or * for all", code="scope_unknown")
    return tuple(scope for scope in ApiScope if scope.value in names)
