"""Depth pictures as 16-bit PNG files; 0 = no data."""

from __future__ import annotations

import io
import math
import struct
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.atomic import write_atomically
from renderer.picture import png_bytes
from simcore.errors import InputError

MAX_COUNT = 65535


def quantise_depth(depth: ArrayLike, depth_unit_m: float) -> NDArray[np.uint16]:
    """Counts of a depth picture, the nearest whole number; uint16, same shape. :func:`dequantise_depth` inverts it.

    Args:
        depth: z-depth [m]; 0 = no data.
        depth_unit_m: metres per count.

    Raises:
        InputError: depths that are not finite, negative, or beyond what 16 bits hold in that unit.
    """
    metres = np.asarray(depth, dtype=np.float64)
    if not np.isfinite(depth_unit_m) or depth_unit_m <= 0.0:
        raise InputError(f"depth unit {depth_unit_m} m must be positive", code="depth_unit")
    if not np.all(np.isfinite(metres)) or metres.min(initial=0.0) < 0.0:
        raise InputError("depth must be finite and not negative; write 0 where there is no data", code="depth_invalid")
    counts = np.rint(metres / depth_unit_m)
    highest = metres.max(initial=0.0)
    if counts.max(initial=0.0) > MAX_COUNT:
        raise InputError(
            f"depth of {highest:.4g} m does not fit 16 bits in units of {depth_unit_m:g} m (up to "
            f"{MAX_COUNT * depth_unit_m:.4g} m): use a depth_unit_m of at least {_rounded_up(highest / MAX_COUNT)}",
            code="depth_overflow",
        )
    if np.any((counts == 0.0) & (metres > 0.0)):
        raise InputError(
            f"depths below half a unit of {depth_unit_m:g} m would read as no data: use a smaller depth_unit_m",
            code="depth_unit",
        )
    return counts.astype(np.uint16)


def _rounded_up(value: float) -> str:
    """A positive number in two digits, none of it cut off."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / digit) * digit:.2g}"


def dequantise_depth(counts: ArrayLike, depth_unit_m: float) -> NDArray[np.float32]:
    """z-depth [m] of counts, float32, same shape; 0 stays 0 = no data."""
    return (np.asarray(counts, dtype=np.float64) * depth_unit_m).astype(np.float32)


def write_depth_png(path: Path | str, depth: ArrayLike, depth_unit_m: float = 1e-4) -> None:
    """Write a depth picture [m], shape [H, W], as a 16-bit grey PNG; whole or not at all.

    Raises:
        InputError: see :func:`depth_png_bytes`; or the file cannot be written.
    """
    write_atomically(path, depth_png_bytes(depth, depth_unit_m))


def depth_png_bytes(depth: ArrayLike, depth_unit_m: float = 1e-4) -> bytes:
    """A depth picture [m], shape [H, W], as a 16-bit grey PNG.

    Raises:
        InputError: see :func:`quantise_depth`; or it has another shape.
    """
    counts = quantise_depth(depth, depth_unit_m)
    if counts.ndim != 2 or 0 in counts.shape:
        raise InputError(f"a depth picture has shape [rows, columns], got {counts.shape}", code="depth_shape")
    return png_bytes(counts)


def read_depth_png(path: Path | str, depth_unit_m: float = 1e-4) -> NDArray[np.float32]:
    """Depth picture [m], float32 [H, W], of a 16-bit grey PNG; 0 = no data.

    Raises:
        InputError: no such file, not a PNG, cut off, of two sizes, or not one channel of 16 bits.
    """
    return dequantise_depth(read_counts(path), depth_unit_m)


def read_counts(path: Path | str) -> NDArray[np.uint16]:
    """Counts of a 16-bit grey PNG, uint16 [H, W]. Raises like :func:`read_depth_png`."""
    from PIL import Image, UnidentifiedImageError

    if Path(path).exists() and not Path(path).is_file():
        raise InputError(f"cannot read depth picture {path}: it is no file", code="depth_missing")
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"cannot read depth picture {path}: {error.strerror}", code="depth_missing") from error
    try:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as picture:
            mode = picture.mode
            _check_size(content, picture.size, path)
            picture.load()
            counts = np.array(picture)
    except UnidentifiedImageError as error:
        raise InputError(f"{path} is not a PNG picture", code="depth_not_png") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        if "MAX_TEXT" in str(error):
            raise InputError(
                f"depth picture {path} holds a text of more than a megabyte beside the pixels: save it without",
                code="depth_damaged",
            ) from error
        raise InputError(f"depth picture {path} is damaged or cut off: {error}", code="depth_damaged") from error
    if mode != "I;16":
        raise InputError(
            f"depth picture {path} must be one channel of 16 bits, got mode {mode!r}: save it as 16-bit grey PNG",
            code="depth_not_16_bit",
        )
    return counts.astype(np.uint16)


def _check_size(content: bytes, size: tuple[int, int], path: Path | str) -> None:
    """Compare the size [pixel] that would be decoded with that of a PNG's first header, by which others judge it.

    Raises:
        InputError: they differ: a later header states another.
    """
    if content[12:16] == b"IHDR" and (stated := struct.unpack(">II", content[16:24])) != size:
        raise InputError(
            f"{path} is {stated[0]} x {stated[1]} pixels by its first header, {size[0]} x {size[1]} by a later one: "
            "save it anew",
            code="depth_damaged",
        )
