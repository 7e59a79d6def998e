"""Where the estimator's model is, told without loading anything heavy."""

from __future__ import annotations

import os
from pathlib import Path

from simcore.errors import MissingResourceError
from trainer.shipped import DEFAULT_MODEL, META_FILE


def find_model(configured: Path | None) -> Path | None:
    """The configured folder, else the model that ships with the package; None where the server can read none."""
    folder = configured if configured is not None else DEFAULT_MODEL
    meta = folder / META_FILE
    try:
        return folder if meta.is_file() and os.access(meta, os.R_OK) else None
    except OSError:  # a folder that the server may not enter
        return None


def require_model(configured: Path | None) -> Path:
    """The same, needed.

    Raises:
        MissingResourceError: there is none.
    """
    folder = find_model(configured)
    if folder is None:
        raise MissingResourceError(
            "the server has no trained model that it can read: set DRAPEMETER_MODEL to a folder made by "
            "`drapemeter train`",
            code="model_missing",
        )
    return folder
