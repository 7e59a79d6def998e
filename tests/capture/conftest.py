"""Fixtures of the capture tests."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from renderer.depth_png import write_depth_png
from simcore.scenes import Scene
from tests.capture.sheets import CAMERA, Sheet, camera_document, make_sheet, turned_pose, with_noise


@pytest.fixture(scope="session")
def hanging() -> Sheet:
    return make_sheet(Scene.HANGING)


@pytest.fixture(scope="session")
def stretched() -> Sheet:
    return make_sheet(Scene.STRETCH)


MakeSet = Callable[..., Path]


@pytest.fixture
def make_set(tmp_path: Path, hanging: Sheet, stretched: Sheet) -> MakeSet:
    """Writes a small capture set: one fabric, both scenes; ``change`` edits the document before it is written."""

    def make(
        change: Callable[[dict[str, Any]], None] = lambda document: None,
        *,
        pose: NDArray[np.float64] | None = None,
        noise_m: float = 0.001,
    ) -> Path:
        folder = tmp_path / "set"
        folder.mkdir()
        true = turned_pose((2.0, 5.0, 1.0)) if pose is None else pose
        for number, sheet in enumerate((hanging, stretched)):
            depth = with_noise(sheet.depth(CAMERA, true), noise_m, 0.01, seed=number)
            write_depth_png(folder / f"f1-{sheet.setup.scene}-0.png", depth)
        document: dict[str, Any] = {
            "format": "drape-capture-set/1",
            "name": "analytic",
            "camera": camera_document(),
            "setup": {"sample_size_m": [0.5, 0.5], "camera_from_panel": None if pose is None else pose.tolist()},
            "fabrics": [{"id": "f1", "density": 0.2, "parameters": None}],
            "captures": [
                {"id": f"f1-{s}-0", "fabric": "f1", "scene": s, "repeat": 0, "depth": f"f1-{s}-0.png"}
                for s in ("hanging", "stretch")
            ],
        }
        change(document)
        (folder / "captures.json").write_text(json.dumps(document))
        return folder

    return make
