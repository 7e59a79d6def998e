"""Captures that show too little of the cloth are refused by name, those that show a part are told of."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.measurement.reference import CELLS
from diagnosis.scene import SimulationScene
from diagnosis.tasks.enough import LEAST_PARTS, check_kept, check_seen, partly_seen
from renderer.depth import panel_depth
from simcore.errors import InputError
from simcore.scenes import Setup

SCENE = SimulationScene(Setup.nominal("stretch"))


def seen(parts: int, visible: int = CELLS**2) -> tuple[Any, Any]:
    """A capture that shows so many cells of the cloth, where a simulated picture shows others, too."""
    weight = np.zeros(CELLS**2 + 24)
    weight[:parts] = 12.0
    cell = np.repeat(np.arange(visible), 12)
    return SimpleNamespace(weight=weight), SimpleNamespace(cell=cell, least_pixels=12)


def test_half_of_the_cloth_is_enough() -> None:
    check_seen("c", *seen(LEAST_PARTS))
    with pytest.raises(InputError, match=r"capture c: 71 of 144 parts .* should see 144: the others are holes"):
        check_seen("c", *seen(LEAST_PARTS - 1))


def test_a_camera_too_far_off_is_told_apart_from_holes() -> None:
    with pytest.raises(InputError, match=r"capture c: 10 of 144 .* could see no more than 20: take pictures with more"):
        check_seen("c", *seen(10, visible=20))


def test_what_is_partly_seen_is_said() -> None:
    said = list(partly_seen({"whole": seen(144), "most": seen(130), "part": seen(100)}))
    assert said == ["capture part: 100 of 144 parts of the cloth are seen well enough to be compared"]


@pytest.mark.parametrize(("off_m", "where"), [(0.4, "0.4 m behind"), (-0.3, "0.3 m before")])
def test_a_picture_of_something_elsewhere_is_refused_before_simulating(off_m: float, where: str) -> None:
    panel = panel_depth(SCENE.camera, SCENE.camera_from_panel).astype(np.float32)
    check_kept("c", panel, panel, SCENE, pose_stated=True)
    nothing = np.zeros_like(panel)
    with pytest.raises(InputError, match=re.escape(f"capture c: what it shows lies {where} the panel")) as caught:
        check_kept("c", panel + np.float32(off_m), nothing, SCENE, pose_stated=True)
    assert caught.value.code == "cloth_not_seen"
    with pytest.raises(InputError, match=r"as it was found in the set's pictures: give camera_from_panel") as caught:
        check_kept("c", panel + np.float32(off_m), nothing, SCENE, pose_stated=False)
    assert "stated" not in str(caught.value)


def test_a_picture_with_hardly_a_pixel_is_refused() -> None:
    few = panel_depth(SCENE.camera, SCENE.camera_from_panel).astype(np.float32)
    few[10:] = 0.0
    few[:, 10:] = 0.0
    with pytest.raises(InputError, match="capture c: 100 pixels show the cloth or what is round it, 864 are the least"):
        check_kept("c", few, few, SCENE, pose_stated=True)
