"""The free edges curl."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from diagnosis.effect import SCALAR, Between, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene
from simcore.mechanics import EdgeCurl

NARROW_M, WIDE_M = 0.025, 0.045
"""Strips that are simulated."""
BETWEEN_M = (0.03, 0.035, 0.04)


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """A strip along all edges."""
    field = EdgeCurl(curvature=size[SCALAR], width_m=size["width_m"])
    return scene.with_mechanics(rest_curvature=(*scene.mechanics.rest_curvature, field))


def anywhere(rng: np.random.Generator) -> Mapping[str, float]:
    """A width between the two that are simulated."""
    return {"width_m": float(rng.uniform(NARROW_M, WIDE_M))}


def between(width_m: float) -> Between:
    """What a strip does goes nearly in a line from the narrow one's to the wide one's."""
    wide = (width_m - NARROW_M) / (WIDE_M - NARROW_M)
    return Between({"width_m": width_m}, {0: 1.0 - wide, 1: wide})


EFFECT = Effect(
    name="edge_curl",
    stage=Stage.FABRIC,
    unit="1/m",
    components=scalar(8.0, 30.0, signed=True),
    summary="A strip along the edges wants to roll up, towards the camera (positive) or the panel.",
    hook="mechanics.rest_curvature",
    source="Curl of single jersey knits.",
    change=change,
    fine=True,
    places=({"width_m": NARROW_M}, {"width_m": WIDE_M}),
    odds=(0.5, 0.5),
    between=tuple(between(width) for width in BETWEEN_M),
    alike=0.95,
    anywhere=anywhere,
    where="`width_m`: width of the strip [m]",
)
