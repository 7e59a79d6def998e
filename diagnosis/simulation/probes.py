"""Weights, bends and turned yarns put on the cloth on trial: something outside the catalogue may be made up of them.

They are no effects: none of them is ever named, and what an effect of the catalogue does in their place is not counted
for something unknown (:mod:`diagnosis.inference.remainder`).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from diagnosis.scene import SimulationScene
from simcore.mechanics import EDGES, UniformCurvature

TRIM_KG_M = 0.02
"""Mass along one edge, as of a tape or a hem."""
BEND_PER_M = 4.0
"""Curvature along weft or along warp that the whole sample would rather have."""
TURN_RAD = 0.07
"""Angle by which the yarns are turned: stretch and shear, bending and twist, which the seven parameters keep apart, go
together."""
PROBES: Mapping[str, int] = MappingProxyType({"weights": len(EDGES), "bends": 2, "turns": 1})
"""How many there are in each family."""
HOOKS: Mapping[str, str] = MappingProxyType(
    {"weights": "mechanics.hem_kg_m", "bends": "mechanics.rest_curvature", "turns": "mechanics.off_grain_rad"}
)
"""Of each family, what effects set that do the like."""


def probed(scene: SimulationScene) -> dict[str, list[SimulationScene]]:
    """A scene with each probe, by family: a mass along each of the edges; a curvature along weft, along warp;
    the yarns turned.
    """
    mechanics = scene.mechanics
    own = dict(zip(EDGES, mechanics.trim_kg_m, strict=True))
    masses = [tuple({**own, edge: own[edge] + TRIM_KG_M}.values()) for edge in EDGES]
    fields = [UniformCurvature(weft=BEND_PER_M), UniformCurvature(warp=BEND_PER_M)]
    return {
        "weights": [scene.with_mechanics(trim_kg_m=mass) for mass in masses],
        "bends": [scene.with_mechanics(rest_curvature=(*mechanics.rest_curvature, field)) for field in fields],
        "turns": [scene.with_mechanics(off_grain_rad=mechanics.off_grain_rad + TURN_RAD)],
    }
