"""Bending is not elastic: what was bent stays bent a little."""

from __future__ import annotations

from diagnosis.effect import SCALAR, Effect, Size, Stage, not_negative, scalar
from diagnosis.scene import SimulationScene
from simcore.errors import InputError
from simcore.mechanics import FrozenCurvature


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """A random frozen curvature; another one in every repeat."""
    if size["seed"] < 0.0 or size["seed"] != int(size["seed"]) or size["seed"] >= 2.0**63:
        raise InputError(f"seed:{size['seed']:g} is none: give a whole number of 0 or more", code="effect_magnitude")
    field = FrozenCurvature(amplitude=not_negative("bending_hysteresis", size[SCALAR]), seed=int(size["seed"]))
    return scene.with_mechanics(rest_curvature=(*scene.mechanics.rest_curvature, field))


EFFECT = Effect(
    name="bending_hysteresis",
    stage=Stage.FABRIC,
    unit="1/m",
    components=scalar(5.0, 20.0),
    summary="Each handling leaves a random curvature of this size (root mean square): repeats scatter more.",
    hook="mechanics.rest_curvature",
    source="Bending hysteresis of Kawabata's tester; internal friction.",
    change=change,
    places=({"seed": 1.0}, {"seed": 2.0}, {"seed": 3.0}),
    where="`seed` chooses the random pattern; in captures every repeat has another one",
    random_repeats=True,
)
