"""What repeats say of each other: how far the magnets were from where they are stated, from repeat to repeat."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.noise import UNMEASURED_LOG_NOISE, NoiseModel
from diagnosis.measurement.reference import PLANE_NAMES
from diagnosis.tasks.fabric_task import CaptureResult

Array = NDArray[np.float64]
PIN_SCATTERS_M = (0.0001, 0.0002, 0.0004, 0.0006, 0.0008, 0.001, 0.0012, 0.0015, 0.002)
UNSEEN_PIN_M = 0.0005
"""Taken where no two repeats show the same fold state."""
SHARE = 0.12
"""Share of a difference's dimensions that counts as independent."""


def pin_scatter(captures: Sequence[CaptureResult], noise: NoiseModel) -> float:
    """Most probable standard deviation of the magnets' places [m], from differences between repeats in ``stretch``.

    An effect that is the same in all repeats cancels in these differences. It comes out at about 0.4 of the true one,
    since their square counts in part and the determinant in full (decision 041).

    Args:
        captures: of the whole set.
        noise: what else differs between repeats.
    """
    pairs = [pair for own in _alike(captures) for pair in combinations(own, 2)]
    if not pairs:
        return UNSEEN_PIN_M
    scores = np.zeros(len(PIN_SCATTERS_M))
    for first, second in pairs:
        difference = first.measured.vector() - second.measured.vector()
        seen = np.isfinite(difference)
        pins = first.responses.pins[:, seen]
        slope = np.append(first.reference.slope, np.zeros(len(PLANE_NAMES)))[seen]
        weight = np.append(first.measured.weight, np.full(len(PLANE_NAMES), 1e3))[seen]
        pixel = first.measured.pixel_variance(UNMEASURED_LOG_NOISE)
        rest = noise.floor_m**2 + noise.repeat_m**2 + pixel / np.maximum(weight, 1.0)
        rest = rest + (noise.slide_m * noise.repeat_share * slope) ** 2 + 1e-10
        scores += [_log_likelihood(difference[seen], pins * scatter, 2.0 * rest) for scatter in PIN_SCATTERS_M]
    return PIN_SCATTERS_M[int(np.argmax(scores))]


def _alike(captures: Sequence[CaptureResult]) -> list[list[CaptureResult]]:
    """Repeats of one fabric in ``stretch`` that show one fold state."""
    groups: dict[tuple[str, int], list[CaptureResult]] = {}
    for capture in captures:
        if capture.scene == "stretch":
            groups.setdefault((capture.fabric, capture.state), []).append(capture)
    return [group for group in groups.values() if len(group) > 1]


def _log_likelihood(difference: Array, pins: Array, variance: Array) -> float:
    """Of a difference under independent errors and two repeats' moves of the pins, tempered; Woodbury's identity."""
    inner = np.eye(len(pins)) + 2.0 * (pins / variance) @ pins.T
    along = np.sqrt(2.0) * (pins / variance) @ difference
    square = float(difference @ (difference / variance)) - float(along @ np.linalg.solve(inner, along))
    return -0.5 * SHARE * square - 0.5 * float(np.linalg.slogdet(inner)[1])
