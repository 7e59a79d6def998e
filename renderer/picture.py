"""Pictures for people: depth made visible, contact sheets with labels, PNG files."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.atomic import write_atomically
from simcore.errors import InputError

Grey = NDArray[np.uint8]
_LABEL_ROWS = 16
_GAP = 4


def depth_to_grey(depth: ArrayLike, near_m: float | None = None, far_m: float | None = None) -> Grey:
    """8-bit picture of a depth picture: near is light, far is dark, no data is black.

    Args:
        depth: z-depth [m], shape [H, W]; 0 = no data.
        near_m, far_m: depths shown as 255 and as 32; left out, the nearest and farthest 0.5 % of the readings are cut.

    Raises:
        InputError: not a picture, or ``near_m`` not before ``far_m``.
    """
    z = np.asarray(depth, dtype=np.float64)
    if z.ndim != 2:
        raise InputError(f"a depth picture has shape [rows, columns], got {z.shape}", code="depth_shape")
    seen = z > 0
    if not seen.any():
        return np.zeros(z.shape, dtype=np.uint8)
    near = float(np.percentile(z[seen], 0.5)) if near_m is None else near_m
    far = float(np.percentile(z[seen], 99.5)) if far_m is None else far_m
    if near_m is not None and far_m is not None and not near < far:
        raise InputError(f"near {near} m must be before far {far} m", code="depth_range")
    share = np.clip((far - z) / max(far - near, 1e-6), 0.0, 1.0)
    return np.where(seen, np.rint(32.0 + 223.0 * share), 0.0).astype(np.uint8)


def contact_sheet(
    pictures: Sequence[Grey], labels: Sequence[str], *, columns: int = 4, title: str | None = None
) -> Grey:
    """Tiles of grey or colour pictures of one size, each with its label above.

    Args:
        pictures: uint8 [H, W] each, or [H, W, 3] each.
        labels: one a picture; cut where they are wider than it.
        columns: tiles a row.
        title: a line over everything.

    Returns:
        uint8 [rows, columns], or [rows, columns, 3] for colour.

    Raises:
        InputError: no picture, pictures of different shapes, or another number of labels.
    """
    from PIL import Image, ImageDraw, ImageFont

    if not pictures or len(pictures) != len(labels) or columns < 1:
        raise InputError("a contact sheet needs pictures, one label each, and at least one column", code="sheet")
    shape = np.asarray(pictures[0]).shape
    if any(np.asarray(p).shape != shape or np.asarray(p).dtype != np.uint8 for p in pictures):
        raise InputError("the pictures of a contact sheet must be 8-bit and of one shape", code="sheet")
    height, width = shape[:2]
    columns = min(columns, len(pictures))
    rows = -(-len(pictures) // columns)
    head = _LABEL_ROWS if title else 0
    size = (columns * (width + _GAP) + _GAP, head + rows * (height + _LABEL_ROWS + _GAP) + _GAP)
    colour = len(shape) == 3
    sheet = Image.new("RGB" if colour else "L", size, (24, 24, 24) if colour else 24)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=11)
    ink = (235, 235, 235) if colour else 235
    if title:
        draw.text((_GAP, 1), title, fill=ink, font=font)
    for k, (picture, label) in enumerate(zip(pictures, labels, strict=True)):
        left = _GAP + (k % columns) * (width + _GAP)
        top = head + _GAP + (k // columns) * (height + _LABEL_ROWS + _GAP)
        while label and draw.textlength(label, font=font) > width:
            label = label[:-1]
        draw.text((left, top), label, fill=ink, font=font)
        sheet.paste(Image.fromarray(picture), (left, top + _LABEL_ROWS))
    return np.asarray(sheet).copy()


def write_png(path: Path | str, picture: Grey) -> None:
    """Write an 8-bit picture, uint8 [H, W] or [H, W, 3], whole or not at all.

    Raises:
        InputError: not an 8-bit picture, or the file cannot be written.
    """
    from PIL import Image

    if picture.dtype != np.uint8 or picture.ndim not in (2, 3):
        raise InputError(
            f"a picture must be uint8 [H, W] or [H, W, 3], got {picture.dtype} {list(picture.shape)}", code="picture"
        )
    content = io.BytesIO()
    Image.fromarray(picture).save(content, format="PNG")
    write_atomically(path, content.getvalue())
