"""Folds that a mesh can and cannot carry."""

from __future__ import annotations

import math

import numpy as np
import pytest

from simcore.resolution import SHARP_RAD, kinked_share


def wave(cells: float, steepest: float, rows: int = 81, columns: int = 121) -> np.ndarray:
    """A sheet with a wave of so many cells along its rows; at its crests it turns by ``steepest`` a cell."""
    v, u = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    k = 2.0 * math.pi / cells
    return np.stack([u, -v, steepest / k**2 * np.sin(k * u)], axis=2).astype(np.float64)


def test_smooth_and_flat_sheets_have_no_kinks() -> None:
    assert kinked_share(wave(20.0, 0.5 * SHARP_RAD)) == 0.0
    assert kinked_share(wave(20.0, 0.0)) == 0.0


@pytest.mark.parametrize("axis", [0, 1])
def test_zigzag_of_the_mesh_is_all_kinks(axis: int) -> None:
    x = wave(20.0, 0.0)
    x[..., 2] = 0.5 * (-1.0) ** np.arange(x.shape[axis]).reshape((-1, 1) if axis == 0 else (1, -1))
    assert kinked_share(x) == 1.0


def test_a_single_sharp_crease_is_its_share() -> None:
    x = wave(20.0, 0.0)
    x[:, 60:, 2] = 2.0 * np.arange(61)
    assert kinked_share(x) == pytest.approx(1 / 119)
