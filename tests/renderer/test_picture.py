"""Pictures for people."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from renderer.picture import png_bytes, write_png
from simcore.errors import InputError


@pytest.mark.parametrize(("kind", "shape"), [(np.uint8, (5, 7)), (np.uint8, (5, 7, 3)), (np.uint16, (5, 7))])
def test_a_picture_comes_back_as_it_was(kind: type, shape: tuple[int, ...], tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, np.iinfo(kind).max, shape).astype(kind)
    write_png(tmp_path / "a.png", picture)
    content = (tmp_path / "a.png").read_bytes()
    assert content == png_bytes(picture) and content.startswith(b"\x89PNG")
    again = np.asarray(Image.open(BytesIO(content)))
    assert again.dtype == kind and np.array_equal(again, picture)


def test_what_is_no_picture_is_refused(tmp_path: Path) -> None:
    picture = np.zeros((8, 8, 3), np.uint8)
    for bad, got in (
        (picture[..., 0].astype(float), r"float64 \[8, 8\]"),
        (picture[0, 0], r"uint8 \[3\]"),
        (picture.astype(np.uint16), r"uint16 \[8, 8, 3\]"),
    ):
        with pytest.raises(InputError, match=rf"must be uint8 .* or uint16 \[H, W\], got {got}") as caught:
            write_png(tmp_path / "a.png", bad)
        assert caught.value.code == "picture"
    assert not list(tmp_path.iterdir())
