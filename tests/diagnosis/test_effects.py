"""The catalogue: complete, well-formed, and every effect changes what it says it changes."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.effect import SCALAR, Stage
from diagnosis.effects import catalogue, get_effect, parse_effect
from diagnosis.scene import SimulationScene
from simcore.errors import InputError
from simcore.scenes import Scene, Setup

NAMES_BY_STAGE = {
    Stage.FABRIC: "stretch_stiffening rest_curvature edge_curl crease bending_hysteresis off_grain hem_weight",
    Stage.SETUP: "pin_spacing pin_drop corner_pull panel_tilt",
    Stage.ENVIRONMENT: "air_draft panel_adhesion panel_friction",
    Stage.CAMERA: "camera_rotation camera_translation focal_scale",
    Stage.SENSOR: "depth_scale depth_bias range_noise quantisation edge_flying_pixels dropout sensor_smoothing",
}


def scene(name: str = "stretch") -> SimulationScene:
    return SimulationScene(Setup.nominal(name))


def test_catalogue_holds_the_twenty_four_effects_of_the_contract() -> None:
    expected = {name: stage for stage, names in NAMES_BY_STAGE.items() for name in names.split()}
    assert {name: effect.stage for name, effect in catalogue().items()} == expected


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_effect_changes_only_its_own_stage(name: str) -> None:
    effect = get_effect(name)
    before = scene()
    after = effect.apply(before, effect.typical())
    changed = {
        field: getattr(after, field) != getattr(before, field)
        for field in ("setup", "mechanics", "camera", "pose", "sensor")
    }
    allowed = {
        Stage.FABRIC: {"mechanics"},
        Stage.SETUP: {"setup", "mechanics"},
        Stage.ENVIRONMENT: {"mechanics"},
        Stage.CAMERA: {"camera", "pose"},
        Stage.SENSOR: {"sensor"},
    }[effect.stage]
    assert any(changed.values())
    assert {field for field, yes in changed.items() if yes} <= allowed


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_prior_draws_lie_in_the_stated_range(name: str) -> None:
    effect = get_effect(name)
    rng = np.random.default_rng(1)
    component = next(iter(effect.components.values()))
    for _ in range(50):
        size = effect.draw(rng)
        values = [size[c] for c in effect.components]
        length = float(np.linalg.norm(values))
        assert 0.999 * component.low <= length <= 1.001 * component.high
        if not component.signed:
            assert min(values) > 0


def test_pin_spacing_moves_both_top_pins_by_half() -> None:
    before = scene("hanging").setup.pins_m
    after = get_effect("pin_spacing").apply(scene("hanging"), 0.006).setup.pins_m
    assert after["top_left"][0] == pytest.approx(before["top_left"][0] - 0.003)
    assert after["top_right"][0] == pytest.approx(before["top_right"][0] + 0.003)


def test_panel_tilt_turns_gravity_towards_the_panel_and_keeps_its_size() -> None:
    gravity = get_effect("panel_tilt").apply(scene(), 8.0).mechanics.gravity
    assert np.linalg.norm(gravity) == pytest.approx(9.81)
    assert gravity[2] == pytest.approx(-9.81 * np.sin(np.radians(8.0)))


def test_corner_pull_leaves_the_hanging_scene_alone() -> None:
    assert get_effect("corner_pull").apply(scene("hanging"), 0.005) == scene("hanging")
    moved = get_effect("corner_pull").apply(scene(), 0.005).setup.pins_m["bottom_right"]
    start = Setup.nominal(Scene.STRETCH).pins_m["bottom_right"]
    assert np.linalg.norm(np.subtract(moved, start)) == pytest.approx(0.005)


def test_depth_scale_and_noise_act_on_what_the_sensor_already_does() -> None:
    base = scene().with_sensor(depth_scale=0.01, range_noise_m=0.003)
    assert get_effect("depth_scale").apply(base, 0.01).sensor.depth_scale == pytest.approx(1.01**2 - 1)
    assert get_effect("range_noise").apply(base, 0.004).sensor.range_noise_m == pytest.approx(0.005)


def test_parse_effect_reads_numbers_and_components() -> None:
    effect, size = parse_effect("air_draft=0.3")
    assert (effect.name, size) == ("air_draft", {SCALAR: 0.3})
    assert parse_effect("camera_rotation=rx:1,rz:-2")[1] == {"rx": 1.0, "ry": 0.0, "rz": -2.0}
    assert parse_effect("crease=1.2")[1] == {SCALAR: 1.2, "down": 1.0, "position": 0.5}
    assert parse_effect("crease=magnitude:1.2,down:0")[1]["down"] == 0.0


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


def test_unknown_name_lists_the_catalogue() -> None:
    with pytest.raises(InputError, match=r"air_draft.*stretch_stiffening"):
        get_effect("wind")
