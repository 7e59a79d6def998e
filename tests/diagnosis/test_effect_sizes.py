"""Sizes of effects as they are written: read, completed, added, refused."""

from __future__ import annotations

import pytest

from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect, parse_effect
from diagnosis.scene import SimulationScene
from simcore.errors import InputError
from simcore.scenes import Setup


def scene() -> SimulationScene:
    return SimulationScene(Setup.nominal("stretch"))


def test_parse_effect_reads_numbers_and_components() -> None:
    effect, size = parse_effect("air_draft=0.3")
    assert (effect.name, size) == ("air_draft", {SCALAR: 0.3})
    assert parse_effect("camera_rotation=rx:1,rz:-2")[1] == {"rx": 1.0, "ry": 0.0, "rz": -2.0}
    assert parse_effect("crease=1.2")[1] == {SCALAR: 1.2, "down": 1.0, "position": 0.5}
    assert parse_effect("crease=magnitude:1.2,down:0")[1]["down"] == 0.0


def test_a_place_given_in_part_is_the_first_that_has_it() -> None:
    def size(text: str) -> dict[str, float]:
        return parse_effect(text)[1]

    assert size("rest_curvature=magnitude:6,warp:1") == {SCALAR: 6.0, "weft": 0.0, "warp": 1.0}  # no bowl
    assert size("rest_curvature=magnitude:6,weft:1") == {SCALAR: 6.0, "weft": 1.0, "warp": 0.0}
    assert size("crease=magnitude:1,down:0") == {SCALAR: 1.0, "down": 0.0, "position": 0.5}
    assert size("crease=magnitude:1,position:0.45") == {SCALAR: 1.0, "down": 1.0, "position": 0.45}
    assert size("crease=magnitude:1,position:0.33") == {SCALAR: 1.0, "down": 1.0, "position": 0.33}  # not a tried one


def test_what_is_wrong_in_a_size_is_pointed_at() -> None:
    with pytest.raises(InputError, match=r"'8' has no name: write edge_curl=magnitude:NUMBER,width_m:NUMBER"):
        parse_effect("edge_curl=8,width_m:0.03")
    with pytest.raises(InputError, match=r"'' has no name"):
        parse_effect("crease=magnitude:1,")


def test_of_several_effects_the_refused_one_is_named() -> None:
    both = get_effect("hem_weight").apply(scene(), 10.0)
    for name, size in (("panel_adhesion", -1.0), ("off_grain", 200.0), ("focal_scale", -1.0)):
        with pytest.raises(InputError, match=f"effect {name} of magnitude {size:g}: "):
            get_effect(name).apply(both, size)


def test_what_cloth_stiffens_by_adds() -> None:
    once = get_effect("stretch_stiffening").apply(scene(), 0.03)
    assert once.mechanics.stiffening_strain == 0.03
    twice = get_effect("stretch_stiffening").apply(once, 0.04)
    assert twice.mechanics.stiffening_strain == pytest.approx(0.024)
    assert twice == get_effect("stretch_stiffening").apply(get_effect("stretch_stiffening").apply(scene(), 0.04), 0.03)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("wind=0.3", "effect_unknown"),
        ("air_draft", "effect_magnitude"),
        ("air_draft=", "effect_magnitude"),
        ("air_draft=much", "effect_magnitude"),
        ("air_draft=nan", "effect_magnitude"),
        ("air_draft=speed:1", "effect_component_unknown"),
    ],
)
def test_unusable_effects_are_refused_with_a_code(text: str, code: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_effect(text)
    assert caught.value.code == code
