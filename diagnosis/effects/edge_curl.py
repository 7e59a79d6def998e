"""The free edges curl."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene
from simcore.mechanics import EdgeCurl


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """A strip along all edges."""
    field = EdgeCurl(curvature=size[SCALAR], width_m=size["width_m"])
    return scene.with_mechanics(rest_curvature=(*scene.mechanics.rest_curvature, field))


def anywhere(rng: np.random.Generator) -> Mapping[str, float]:
    """A width between the two that are tried."""
    return {"width_m": float(rng.uniform(0.025, 0.045))}


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
    places=({"width_m": 0.025}, {"width_m": 0.045}),
    anywhere=anywhere,
    where="`width_m`: width of the strip [m]",
)
