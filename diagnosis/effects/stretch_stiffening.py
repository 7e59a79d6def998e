"""The fabric stiffens as it is stretched."""

from __future__ import annotations

import math

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """Strain at which the tensile moduli have doubled; what they grow by adds, as the square of the strain."""
    strain, before = size[SCALAR], scene.mechanics.stiffening_strain
    if before is not None and strain > 0.0:
        strain = 1.0 / math.hypot(1.0 / before, 1.0 / strain)
    return scene.with_mechanics(stiffening_strain=strain)


EFFECT = Effect(
    name="stretch_stiffening",
    stage=Stage.FABRIC,
    unit="strain",
    components=scalar(0.015, 0.08),
    summary="The warp and weft moduli grow with tensile strain and have doubled at the given strain.",
    hook="mechanics.stiffening_strain",
    source="J-shaped load-strain curves of woven fabrics, Wang et al. 2011.",
    change=change,
    vanishes_at_zero=False,
    fine=True,
)
