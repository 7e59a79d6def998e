"""Figures of the drape distance: any text may be an id."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from metric.figures import embedding_figure, search_figure
from simcore.scenes import Scene

PICTURE = np.zeros((64, 64), dtype=np.uint8)
NAMES = ["$x_{$", "a$b$", "50% & <b>"]


def test_an_id_is_drawn_as_it_stands_and_never_read_as_mathematics(tmp_path: Path) -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.5], [0.3, 1.0]])
    embedding_figure(tmp_path / "e.png", points, NAMES, [PICTURE, None, PICTURE], title="$\\frac")
    pictures = {Scene.HANGING: PICTURE, Scene.STRETCH: PICTURE}
    search_figure(tmp_path / "s.svg", pictures, {"$d_{": [(name, 0.1, pictures) for name in NAMES]})
    assert (tmp_path / "e.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (tmp_path / "s.svg").read_text()
