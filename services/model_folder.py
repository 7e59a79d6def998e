"""Where the service's estimator is, told without loading anything heavy, and the estimator itself."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from simcore.errors import InputError, MissingResourceError
from trainer.shipped import DEFAULT_MODEL, META_FILE, WEIGHTS_FILE

if TYPE_CHECKING:
    from trainer.predict import Estimator


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


def load_model(model: Path) -> Estimator:
    """The estimator of a folder, read again when its files have changed.

    Raises:
        MissingResourceError: there is none, or it cannot be read.
    """
    try:
        files = [(model / name).stat() for name in (META_FILE, WEIGHTS_FILE)]
    except OSError:
        files = []  # reading it says what is wrong
    return _read(model, tuple((file.st_mtime_ns, file.st_size) for file in files))


@lru_cache(maxsize=1)
def _read(model: Path, state: tuple[tuple[int, int], ...]) -> Estimator:
    """The estimator of a folder in one state of its files: when they were written [ns] and their sizes [byte]."""
    import torch

    from trainer.predict import Estimator

    torch.set_num_threads(1)  # the other cores are the jobs'
    try:
        return Estimator.load(model)
    except InputError as error:  # the server's fault, not the caller's
        raise MissingResourceError(str(error), code=error.code) from None
    except OSError as error:
        raise MissingResourceError(
            f"the server cannot read its model ({error.strerror}): let it read the folder of DRAPEMETER_MODEL",
            code="model_missing",
        ) from None
