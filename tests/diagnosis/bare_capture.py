"""A capture with nothing but what its errors hang on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from diagnosis.measurement.features import Features
from diagnosis.measurement.reference import PLANE_NAMES

BARE_CELLS = 9
"""Cells."""
BARE_LENGTH = BARE_CELLS + len(PLANE_NAMES)
"""Of a shape-and-plane vector."""


def bare_capture(rms_m: float, pose: np.ndarray | None = None, setup: int = 0) -> Any:
    """In `stretch`, so far from its state [m]; ``pose`` [6, BARE_LENGTH] and ``setup`` as in ``CaptureResult``."""
    reference = SimpleNamespace(
        count=BARE_CELLS,
        length=BARE_LENGTH,
        centre=np.random.default_rng(0).random((BARE_CELLS, 2)),
        slope=np.ones(BARE_CELLS),
        height=np.zeros(BARE_CELLS),
    )
    nothing = np.zeros(BARE_LENGTH)
    responses = SimpleNamespace(
        pins=np.zeros((8, BARE_LENGTH)), mesh=nothing, grip=nothing, parameters=np.zeros((7, BARE_LENGTH))
    )
    shape, plane = np.zeros(BARE_CELLS), np.zeros(len(PLANE_NAMES))
    measured = Features(shape, plane, np.full(7, -7.0), np.full(BARE_CELLS, 50.0))
    return SimpleNamespace(
        reference=reference,
        responses=responses,
        measured=measured,
        rms_m=rms_m,
        noise_m2=0.0,
        scene="stretch",
        pose=pose,
        setup=setup,
    )
