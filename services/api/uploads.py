"""Uploaded pictures and capture sets, checked before anything decodes or unpacks them."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from simcore.errors import InputError
from simcore.json_text import first_not_finite, parse_json

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER_BYTES = 33

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class PictureSize:
    """Width and height [pixel]."""

    width: int
    height: int


def check_png(content: bytes, name: str, most_pixels: int) -> PictureSize:
    """Look at a PNG's header only: a small file can promise a huge picture.

    Raises:
        InputError: no 16-bit grey PNG, or more pixels than allowed.
    """
    if len(content) < HEADER_BYTES or not content.startswith(PNG_SIGNATURE) or content[12:16] != b"IHDR":
        raise InputError(f"{name} is not a PNG file: send a 16-bit depth picture", code="depth_not_png")
    width, height, bits, colour = struct.unpack(">IIBB", content[16:26])
    if not 0 < width * height <= most_pixels:
        raise InputError(
            f"{name} is {width} x {height} pixels: from 1 to {most_pixels} pixels are taken", code="depth_too_large"
        )
    if bits != 16 or colour != 0:
        raise InputError(
            f"{name} is not a 16-bit single-channel PNG: send depth in camera.depth_unit_m a count, 0 = no data",
            code="depth_not_16_bit",
        )
    return PictureSize(width, height)


def parse_json_field(text: str, name: str, model: type[Model]) -> Model | None:
    """A form field that holds JSON, or nothing.

    Raises:
        InputError: no valid JSON, or not of the model's form.
    """
    if not text.strip():
        return None
    try:
        place = first_not_finite(parse_json(text, name))
    except InputError as error:
        raise InputError(str(error), code=f"{name}_invalid") from None
    except RecursionError:
        raise InputError(f"{name}: not valid JSON (nested too deeply)", code=f"{name}_invalid") from None
    if place is not None:
        raise InputError(f"{name}: {place or 'it'} is not a finite number", code=f"{name}_invalid")
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join([name, *(str(part) for part in first["loc"])])
        raise InputError(f"{place}: {first['msg']}", code=f"{name}_invalid") from None
