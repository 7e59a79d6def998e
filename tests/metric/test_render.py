"""Pictures are checked where they enter the metric."""

from __future__ import annotations

import numpy as np
import pytest

from metric.render import DrapeRender
from simcore.errors import InputError

PICTURE = np.tile(np.arange(64, dtype=np.uint8), (64, 1))
DEPTH = np.full((64, 64), 0.9, np.float32)


@pytest.mark.parametrize(
    ("shaded", "code"),
    [
        (PICTURE.astype(np.float32) / 255, "image_range"),
        (PICTURE[:, :, None], "image_channels"),
        (np.zeros((64, 64), np.uint8), "image_constant"),
        (PICTURE[:10], "image_size"),
    ],
)
def test_unusable_shaded_pictures(shaded: np.ndarray, code: str) -> None:
    with pytest.raises(InputError) as caught:
        DrapeRender(shaded=shaded)
    assert caught.value.code == code


@pytest.mark.parametrize(
    ("depth", "code"),
    [
        (np.where(np.eye(64) > 0, np.nan, DEPTH).astype(np.float32), "image_not_finite"),
        (np.zeros((64, 64), np.float32), "image_constant"),
        (-DEPTH, "image_range"),
        (DEPTH * 1000, "image_range"),
        (DEPTH.astype(np.float64), "image_range"),
        (DEPTH[None], "image_channels"),
    ],
)
def test_unusable_depth_pictures(depth: np.ndarray, code: str) -> None:
    with pytest.raises(InputError) as caught:
        DrapeRender(depth=depth)
    assert caught.value.code == code


def test_pictures_of_one_render_have_one_size() -> None:
    with pytest.raises(InputError) as caught:
        DrapeRender(shaded=PICTURE, depth=np.full((32, 64), 0.9, np.float32))
    assert caught.value.code == "image_size"


def test_an_empty_render() -> None:
    with pytest.raises(InputError, match="a shaded or a depth picture") as caught:
        DrapeRender()
    assert caught.value.code == "render_empty"


def test_a_render_without_the_needed_picture() -> None:
    with pytest.raises(InputError, match="--backend lpips") as caught:
        DrapeRender(shaded=PICTURE).need_depth()
    assert caught.value.code == "render_lacks_depth"
    with pytest.raises(InputError, match="--backend depth") as caught:
        DrapeRender(depth=DEPTH).need_shaded()
    assert caught.value.code == "render_lacks_shaded"
