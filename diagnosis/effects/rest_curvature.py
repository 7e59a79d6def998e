"""The fabric is curved when nothing acts on it."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene
from simcore.mechanics import UniformCurvature


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Along weft, along warp or both, as the place says."""
    field = UniformCurvature(weft=size[SCALAR] * size["weft"], warp=size[SCALAR] * size["warp"])
    return scene.with_mechanics(rest_curvature=(*scene.mechanics.rest_curvature, field))


EFFECT = Effect(
    name="rest_curvature",
    stage=Stage.FABRIC,
    unit="1/m",
    components=scalar(3.0, 12.0, signed=True),
    summary="The flat sample would rather be a cylinder or a bowl; positive bends its ends towards the camera.",
    hook="mechanics.rest_curvature",
    source="Cloth stored on a roll; knitted fabrics.",
    change=change,
    places=({"weft": 1.0, "warp": 0.0}, {"weft": 0.0, "warp": 1.0}, {"weft": 1.0, "warp": 1.0}),
    where="`weft`, `warp`: 1 where it is bent along these yarns, 0 where not",
)
