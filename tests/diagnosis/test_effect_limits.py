"""Sizes that effects may have, and what of an effect's file would fail later."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from diagnosis.afresh.second import around
from diagnosis.effect import Effect, scalar, vector
from diagnosis.effects import catalogue, get_effect, parse_effect
from diagnosis.scene import SimulationScene
from diagnosis.simulation.sizes import grid
from renderer.sensor import SensorModel
from simcore.errors import InputError
from simcore.scenes import Setup


@pytest.mark.parametrize("name", [n for n, e in catalogue().items() if not e.vector])
def test_every_size_that_may_be_fitted_can_be_simulated(name: str) -> None:
    effect = get_effect(name)
    for scene in (Setup.nominal("hanging"), Setup.nominal("stretch")):
        for size in (grid(effect)[0], grid(effect)[-1]):
            effect.apply(SimulationScene(scene), float(size))


@pytest.mark.parametrize(("name", "key"), [("dropout", "dropout"), ("edge_flying_pixels", "flying_pixels")])
def test_what_a_sensor_misses_already_it_misses_still(name: str, key: str) -> None:
    known = SimulationScene(Setup.nominal("stretch"), sensor=SensorModel(**{key: 0.25}))
    assert get_effect(name).apply(known, 0.0) == known
    assert getattr(get_effect(name).apply(known, 0.2).sensor, key) == pytest.approx(0.4)
    plain = SimulationScene(Setup.nominal("stretch"))
    assert getattr(get_effect(name).apply(plain, 0.3).sensor, key) == 0.3


@pytest.mark.parametrize("text", ["panel_tilt=400", "panel_tilt=-91", "bending_hysteresis=-5"])
def test_sizes_that_cannot_be_are_refused(text: str) -> None:
    effect, size = parse_effect(text)
    with pytest.raises(InputError) as caught:
        effect.apply(SimulationScene(Setup.nominal("hanging")), size)
    assert caught.value.code == "effect_magnitude"


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"random_repeats": True}, "places with a seed"),
        ({"vanishes_at_zero": False, "components": scalar(1.0, 2.0, signed=True)}, "one sign"),
        ({"vector": True, "random_repeats": True, "components": vector(("x", "y"), 1.0, 2.0)}, "not a vector"),
        ({"places": ({"width": "wide"},)}, "finite number"),
        ({"components": {"magnitude": (1.0, 2.0)}}, "scalar"),
    ],
)
def test_effects_that_would_fail_later_are_refused(fields: dict[str, Any], said: str) -> None:
    known = get_effect("air_draft")
    own = {f.name: getattr(known, f.name) for f in dataclasses.fields(known)} | {"twin": None, "presses": 0} | fields
    with pytest.raises(InputError, match=said):
        Effect(**own)


def test_a_size_has_a_largest_one_above_the_usual() -> None:
    with pytest.raises(InputError, match=r"most=0\.5"):
        scalar(0.2, 0.9, most=0.5)
    mixed = get_effect("edge_flying_pixels")
    assert grid(mixed)[-1] == pytest.approx(1.0) and around(mixed, 0.9)[1] == 1.0
