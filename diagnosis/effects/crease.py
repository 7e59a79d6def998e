"""A pressed fold line."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene
from simcore.mechanics import Crease


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """A line down the sample (down 1) or across it (down 0), at a share of its width or height."""
    field = Crease(size[SCALAR], along="warp" if size["down"] > 0.5 else "weft", position=size["position"])
    return scene.with_mechanics(rest_curvature=(*scene.mechanics.rest_curvature, field))


EFFECT = Effect(
    name="crease",
    stage=Stage.FABRIC,
    unit="rad",
    components=scalar(0.5, 1.5, signed=True),
    summary="The sample was folded and pressed: along a line it wants to stay bent by this angle.",
    hook="mechanics.rest_curvature",
    source="Samples that come folded by post.",
    change=change,
    places=({"down": 1.0, "position": 0.5}, {"down": 0.0, "position": 0.5}),
    where="`down` 1: a line from top to bottom, `position` from the left as a share of the width; "
    "`down` 0: a line from side to side, `position` from the top as a share of the height",
)
