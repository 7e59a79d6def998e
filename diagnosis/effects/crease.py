"""A pressed fold line."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from diagnosis.effect import SCALAR, Between, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene
from simcore.mechanics import Crease

POSITIONS = (0.5, 0.4, 0.6, 0.3, 0.7, 0.2, 0.8)
"""Lines that are simulated, either way."""
BETWEEN = (0.25, 0.35, 0.45, 0.55, 0.65, 0.75)
"""Lines between two of them."""
MIDDLE = 12.0
"""How much more probable a fold in the middle is than one at any other line: half of all."""


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """A line down the sample (down 1) or across it (down 0), at a share of its width or height."""
    field = Crease(size[SCALAR], along="warp" if size["down"] > 0.5 else "weft", position=size["position"])
    return scene.with_mechanics(rest_curvature=(*scene.mechanics.rest_curvature, field))


def anywhere(rng: np.random.Generator) -> Mapping[str, float]:
    """Half of all down or across the middle, as samples are folded; the others anywhere but near the rim."""
    position = 0.5 if rng.random() < 0.5 else float(rng.uniform(0.15, 0.85))
    return {"down": float(rng.integers(2)), "position": position}


def between(position: float, down: float) -> Between:
    """What a fold does is about the mean of what those half a tenth of the sample to either side do."""
    neighbours = [PLACES.index({"down": down, "position": round(position + way, 2)}) for way in (-0.05, 0.05)]
    return Between({"down": down, "position": position}, dict.fromkeys(neighbours, 0.5))


PLACES = tuple({"down": down, "position": position} for position in POSITIONS for down in (1.0, 0.0))

EFFECT = Effect(
    name="crease",
    stage=Stage.FABRIC,
    unit="rad",
    components=scalar(0.5, 1.5, signed=True),
    summary="The sample was folded and pressed: along a line it wants to stay bent by this angle.",
    hook="mechanics.rest_curvature",
    source="Samples that come folded by post.",
    change=change,
    places=PLACES,
    odds=tuple(MIDDLE if place["position"] == 0.5 else 1.0 for place in PLACES),
    between=tuple(between(position, down) for position in BETWEEN for down in (1.0, 0.0)),
    anywhere=anywhere,
    where="`down` 1: a line from top to bottom, `position` from the left as a share of the width; "
    "`down` 0: a line from side to side, `position` from the top as a share of the height",
)
