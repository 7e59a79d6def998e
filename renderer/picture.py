"""Pictures for people, as PNG."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from renderer.atomic import write_atomically
from simcore.errors import InputError

Picture = NDArray[np.uint8] | NDArray[np.uint16]
_AXES = {"uint8": (2, 3), "uint16": (2,)}


def png_bytes(picture: Picture) -> bytes:
    """A picture as a PNG: uint8 [H, W] (grey) or [H, W, 3] (colour), or uint16 [H, W] (counts of depth).

    Raises:
        InputError: another type or shape.
    """
    from PIL import Image

    if picture.ndim not in _AXES.get(picture.dtype.name, ()):
        raise InputError(
            f"a picture must be uint8 [H, W] or [H, W, 3], or uint16 [H, W], got {picture.dtype} {list(picture.shape)}",
            code="picture",
        )
    content = io.BytesIO()
    Image.fromarray(picture).save(content, format="PNG")
    return content.getvalue()


def write_png(path: Path | str, picture: Picture) -> None:
    """Write a picture whole or not at all.

    Raises:
        InputError: see :func:`png_bytes`; or the file cannot be written.
        DrapemeterError: the disk is full.
    """
    write_atomically(path, png_bytes(picture))
