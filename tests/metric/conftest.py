"""Drape-like pictures without a simulator, and the back ends' weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from metric.backends import Channel, SquaredEuclideanBackend
from metric.euclidean import squared_distance_table
from metric.render import DrapeRender


def folded_render(folds: float = 3.0, phase: float = 0.0, amplitude_m: float = 0.03, size: int = 128) -> DrapeRender:
    """A hanging-like height field: vertical folds that deepen towards the hem, Lambertian from the camera."""
    y, x = np.mgrid[0:size, 0:size] / (size - 1.0)
    cloth = (np.abs(x - 0.5) < 0.35) & (y > 0.1) & (y < 0.9)
    height = amplitude_m * (0.2 + y) * (1.0 + np.cos(2 * np.pi * folds * x + phase))
    slope_y, slope_x = np.gradient(height, 0.72 / size)
    light = 1.0 / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    shaded = np.where(cloth, np.clip(230 * light, 1, 255), 0).astype(np.uint8)
    depth = np.where(cloth, 0.9 - height, 0.0).astype(np.float32)
    return DrapeRender(shaded=shaded, depth=depth)


@pytest.fixture
def make_render() -> Callable[..., DrapeRender]:
    """`make_render(folds, phase, amplitude_m, size)`."""
    return folded_render


class Pixels:
    """Pixels as features, squared distance as distance."""

    name = "pixels"
    channel = Channel.SHADED
    unit = ""
    fingerprint = "pixels/1"
    squared_distance_unit = 1.0

    def features(self, renders: Sequence[DrapeRender]) -> list[np.ndarray]:
        return [(r.need_shaded() / 255.0).astype(np.float32).ravel() / 128 for r in renders]

    def table(self, a: Sequence[np.ndarray], b: Sequence[np.ndarray]) -> np.ndarray:
        return squared_distance_table(a, b)


@pytest.fixture
def pixels() -> SquaredEuclideanBackend:
    """A back end that needs no weights and can be sketched."""
    return Pixels()


@pytest.fixture(scope="session")
def weights_dir(shared_dir: Path) -> Path:
    """Folder with SqueezeNet's weights."""
    return shared_dir / "weights"
