"""Where results go: found unusable before the work that makes them, not after it."""

from __future__ import annotations

import os
from pathlib import Path

from simcore.errors import InputError

CODE_FOLDER = "folder_unusable"


def check_folder(folder: Path, otherwise: str) -> None:
    """Refuse a folder that could not be made or written to later; nothing is made now.

    Args:
        folder: there or not.
        otherwise: what to do if it cannot be used, for the message.

    Raises:
        InputError: it is a file, lies under one, or cannot be written to.
    """
    there = folder.absolute()
    while not os.path.lexists(there):
        there = there.parent
    if not there.is_dir():
        raise InputError(f"{folder} cannot be made ({there} is not a folder): {otherwise}", code=CODE_FOLDER)
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{folder} cannot be written to: {otherwise}", code=CODE_FOLDER)


def make_folder(folder: Path, otherwise: str) -> Path:
    """Make a folder for results before the work that fills it.

    Args:
        folder: the folder.
        otherwise: what to do if it cannot be made, for the message.

    Raises:
        InputError: it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder} cannot be made ({error.strerror}): {otherwise}", code=CODE_FOLDER) from None
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder} cannot be written to: {otherwise}", code=CODE_FOLDER)
    return folder


def check_file(path: Path) -> None:
    """Refuse a file that could not be written later; its folder need not be there yet, and nothing is made now.

    Raises:
        InputError: a folder is in its place, or its own folder cannot be used.
    """
    if path.is_dir():
        raise InputError(f"{path} is a folder: name a file", code="output_is_folder")
    check_folder(path.absolute().parent, "name a place that can be written to")


def check_figure(path: Path) -> None:
    """Refuse a figure that could not be written later, and make its folder.

    Raises:
        InputError: another kind of file than PNG, PDF or SVG, or a folder that cannot be made.
    """
    if path.suffix.lower() not in {".png", ".pdf", ".svg"}:
        raise InputError(f"{path}: name a .png, .pdf or .svg file", code="figure_form")
    check_file(path)
    make_folder(path.absolute().parent, "name a place that can be written to")
