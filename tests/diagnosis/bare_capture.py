"""A capture with nothing but what its errors hang on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

BARE_CELLS = 9
"""Cells."""


def bare_capture(rms_m: float, pose: np.ndarray | None = None) -> Any:
    """In `stretch`, so far from its state [m]; ``pose`` as in ``CaptureResult``, [6, BARE_CELLS + 3]."""
    reference = SimpleNamespace(
        count=BARE_CELLS,
        centre=np.random.default_rng(0).random((BARE_CELLS, 2)),
        slope=np.ones(BARE_CELLS),
        height=np.zeros(BARE_CELLS),
    )
    nothing = np.zeros(BARE_CELLS + 3)
    responses = SimpleNamespace(
        pins=np.zeros((8, BARE_CELLS + 3)), mesh=nothing, grip=nothing, parameters=np.zeros((7, BARE_CELLS + 3))
    )
    measured = SimpleNamespace(pixels=np.full(7, -7.0), weight=np.full(BARE_CELLS, 50.0))
    return SimpleNamespace(
        reference=reference, responses=responses, measured=measured, rms_m=rms_m, scene="stretch", pose=pose
    )
