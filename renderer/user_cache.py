"""Where what can be made again is kept between runs: one folder of the user's."""

from __future__ import annotations

import os
from pathlib import Path

CACHE_VARIABLE = "DRAPEMETER_CACHE"


def default_cache_folder() -> Path | None:
    """``DRAPEMETER_CACHE`` (empty: None, nothing is kept), else ``drapemeter`` in the user's cache folder."""
    named = os.environ.get(CACHE_VARIABLE)
    if named is not None:
        return Path(named) if named else None
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "drapemeter"
