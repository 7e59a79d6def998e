"""What every room's tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root of the repository."""
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_dir() -> Path:
    """Folder of the shared data (`DRAPEMETER_SHARED`, else `../shared`); the test is skipped where there is none."""
    folder = Path(os.environ.get("DRAPEMETER_SHARED") or REPOSITORY.parent / "shared")
    if not (folder / "contracts").is_dir():
        pytest.skip("the shared data is not here: set DRAPEMETER_SHARED to its folder")
    return folder
