"""The estimator's own trunk as an image distance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metric.backends import distance
from metric.render import DrapeRender
from services.trunk_features import trunk_distance
from simcore.errors import InputError


def folded(folds: float, phase: float = 0.0) -> DrapeRender:
    y, x = np.mgrid[0:256, 0:256] / 255.0
    cloth = (np.abs(x - 0.5) < 0.3) & (np.abs(y - 0.5) < 0.35)
    height = 0.03 * (0.2 + y) * (1 + np.cos(2 * np.pi * folds * x + phase))
    return DrapeRender(depth=np.where(cloth, 0.9 - height, 0).astype(np.float32))


def test_trunk_tells_drapes_apart(tiny_model_folder: Path) -> None:
    backend = trunk_distance(tiny_model_folder)
    assert distance(backend, folded(2.0), folded(2.0)) == pytest.approx(0.0, abs=1e-3)
    assert 0 < distance(backend, folded(2.0), folded(2.0, 0.1)) < distance(backend, folded(2.0), folded(6.0))
    assert backend.fingerprint == trunk_distance(tiny_model_folder).fingerprint


def test_no_model(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        trunk_distance(tmp_path / "none")
