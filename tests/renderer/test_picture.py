"""Pictures for people."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from renderer.picture import contact_sheet, depth_to_grey, write_png
from simcore.errors import InputError


def test_near_is_light_and_no_data_is_black() -> None:
    depth = np.array([[0.0, 0.8], [0.85, 0.9]])
    assert depth_to_grey(depth, 0.8, 0.9).tolist() == [[0, 255], [144, 32]]
    assert depth_to_grey(np.zeros((2, 2))).max() == 0
    assert depth_to_grey(np.full((2, 2), 0.9)).min() >= 32
    for near in (0.9, 0.8, math.nan):
        with pytest.raises(InputError, match=f"near {near} m must be before far 0.8 m") as caught:
            depth_to_grey(depth, near, 0.8)
        assert caught.value.code == "depth_range"


def test_contact_sheet_holds_every_picture_unchanged(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 255, (40, 50)).astype(np.uint8) for _ in range(5)]
    sheet = contact_sheet(pictures, [f"drape {k} with a long name" for k in range(5)], columns=3, title="five")
    windows = np.lib.stride_tricks.sliding_window_view(sheet, (40, 50))
    for picture in pictures:
        assert (windows == picture).all(axis=(2, 3)).sum() == 1
    write_png(tmp_path / "sheet.png", sheet)
    assert (tmp_path / "sheet.png").read_bytes().startswith(b"\x89PNG")
    colour = contact_sheet([np.zeros((8, 8, 3), np.uint8)], [""])
    assert colour.shape[2] == 3


def test_bad_sheets_are_refused(tmp_path: Path) -> None:
    picture = np.zeros((8, 8), np.uint8)
    for pictures, labels in (([], []), ([picture], []), ([picture, picture[:4]], ["a", "b"])):
        with pytest.raises(InputError, match="contact sheet") as caught:
            contact_sheet(pictures, labels)
        assert caught.value.code == "sheet"
    for bad, got in ((picture.astype(float), r"float64 \[8, 8\]"), (picture[0], r"uint8 \[8\]")):
        with pytest.raises(InputError, match=rf"must be uint8 \[H, W\] or \[H, W, 3\], got {got}") as caught:
            write_png(tmp_path / "a.png", bad)
        assert caught.value.code == "picture"
    assert not list(tmp_path.iterdir())
