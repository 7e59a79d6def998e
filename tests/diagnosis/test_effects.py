"""The catalogue: complete, well-formed, and every effect changes what it says it changes."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagnosis import effects
from diagnosis.effect import SCALAR, Between, Component, Effect, Stage
from diagnosis.effects import catalogue, get_effect, parse_effect
from diagnosis.pages import effect_page
from diagnosis.scene import SimulationScene
from diagnosis.simulation.sizes import at_all_places, node_weights, nodes
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


def test_unknown_name_lists_the_catalogue() -> None:
    with pytest.raises(InputError, match=r"air_draft.*stretch_stiffening"):
        get_effect("wind")


PAGE = "docs/effects.md"
Add = Callable[[str, str], None]


@pytest.fixture
def add(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Add]:
    """``add("pin_height", text)``: a further file of the catalogue, for one test."""
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    added: list[str] = []

    def write(name: str, text: str) -> None:
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        added.append(name)
        catalogue.cache_clear()

    yield write
    catalogue.cache_clear()
    for name in added:
        sys.modules.pop(f"{effects.__name__}.{name}", None)
        effects.__dict__.pop(name, None)


def example(repository: Path) -> str:
    """The file that the page gives as an example, as people copy it from there."""
    code = re.findall(r"```python\n(.*?)```", (repository / PAGE).read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(code) == 1
    return str(code[0])


def test_the_pages_example_of_an_own_effect_is_in_the_catalogue_by_being_there(add: Add, repository: Path) -> None:
    assert "pin_height" not in catalogue()
    add("pin_height", example(repository))
    assert list(catalogue()) == sorted(catalogue()) and len(catalogue()) == 25
    effect, size = parse_effect("pin_height=0.004")
    before = scene()
    after = effect.apply(before, size)
    assert all(
        place == pytest.approx((*before.setup.pins_m[name][:2], 0.004)) for name, place in after.setup.pins_m.items()
    )
    assert (after.mechanics, after.camera, after.pose, after.sensor) == (
        before.mechanics,
        before.camera,
        before.pose,
        before.sensor,
    )
    twice = effect.apply(after, 0.001).setup.pins_m["top_left"]
    assert twice[2] == pytest.approx(0.005)
    assert effect.stage is Stage.SETUP and effect.moves_cloth and len(nodes(effect)) == 2


def test_a_file_without_an_effect_is_refused(add: Add) -> None:
    add("pin_height", "HEIGHT = 0.004\n")
    with pytest.raises(InputError, match=r"diagnosis/effects/pin_height\.py has no EFFECT") as caught:
        catalogue()
    assert caught.value.code == "effect_file"


@pytest.mark.parametrize(
    ("text", "change", "said"),
    [
        ("pin_height", "un known", "cannot be an effect's name"),
        ('name="pin_height"', 'name="unknown"', "cannot be an effect's name"),
        ("scalar(0.002, 0.010", "scalar(0.0, 0.010", "two positive numbers"),
        ("scalar(0.002, 0.010", "scalar(0.010, 0.002", "two positive numbers"),
        ("change=change", "presses=2, change=change", "give 1 or -1 to an effect whose size is one number"),
        ("from diagnosis.scene", "import no_such_module\nfrom diagnosis.scene", "pin_height.py cannot be used"),
        ("EFFECT = ", "EFFECT := ", "pin_height.py cannot be used: SyntaxError"),
        ("stage=Stage.SETUP", 'stage="setup"', "give one of Stage.FABRIC"),
        ("change=change", "places=(), change=change", "give at least one, all with the same names"),
        ("change=change", 'places={"width_m": 0.02}, change=change', "give a tuple of mappings"),
        ("change=change", 'places=({"a": 1.0}, {"b": 1.0}), change=change', "all with the same names"),
        ("change=change", 'places=({"magnitude": 1.0},), change=change', "give their numbers other names"),
        ("change=change", "vector=True, places=({'a': 1.0},), change=change", "a vector has no places"),
        ("change=change", 'places=({"a": 1.0}, {"a": 2.0}), odds=(1.0,), change=change', "give 2 positive numbers"),
        ("change=change", 'places=({"a": 1.0},), odds=(0.0,), change=change', "give 1 positive numbers"),
    ],
)
def test_files_that_cannot_be_used_are_named(add: Add, repository: Path, text: str, change: str, said: str) -> None:
    whole = example(repository)
    assert text in whole
    add("pin_height", whole.replace(text, change))
    with pytest.raises(InputError, match=said) as caught:
        catalogue()
    assert caught.value.code == "effect_file"


def test_a_change_that_gives_no_scene_is_told(add: Add, repository: Path) -> None:
    add("pin_height", re.sub(r"    return .*", "    pass", example(repository)))
    with pytest.raises(InputError, match="return the changed scene") as caught:
        get_effect("pin_height").apply(scene(), 0.004)
    assert caught.value.code == "effect_file"


@pytest.mark.parametrize(
    ("place", "shares", "said"),
    [
        ({"width_m": 0.03}, {0: 0.5}, "sum to one"),
        ({"width_m": 0.03}, {0: 0.5, 2: 0.5}, "places 0 to 1"),
        ({"width_m": 0.045}, {1: 1.0}, "is simulated"),
        ({"width": 0.03}, {1: 1.0}, "the same names"),
    ],
)
def test_places_between_others_are_mixed_of_those_alone(
    place: dict[str, float], shares: dict[int, float], said: str
) -> None:
    with pytest.raises(InputError, match=said) as caught:
        replace(get_effect("edge_curl"), between=(Between(place, shares),))
    assert caught.value.code == "effect_file"


@pytest.mark.parametrize("names", [(), ("lift",), (SCALAR, "x")])
def test_components_are_one_number_or_a_vector(names: tuple[str, ...]) -> None:
    components = dict.fromkeys(names, Component(0.1, 1.0))
    with pytest.raises(InputError, match="components") as caught:
        replace(get_effect("hem_weight"), components=components)
    assert caught.value.code == "effect_file"


def test_a_change_that_fails_is_told_with_its_effect(add: Add, repository: Path) -> None:
    add("pin_height", re.sub(r"    return .*", '    return scene.setup.pins_m["middle"]', example(repository)))
    with pytest.raises(InputError, match="pin_height: its change of a stretch scene fails: KeyError") as caught:
        get_effect("pin_height").apply(scene(), 0.004)
    assert caught.value.code == "effect_file"


def test_a_change_of_what_another_stage_changes_is_refused(add: Add, repository: Path) -> None:
    add("pin_height", example(repository).replace("Stage.SETUP", "Stage.CAMERA"))
    with pytest.raises(InputError, match="its change sets setup, an effect of the camera stage camera and pose alone"):
        get_effect("pin_height").apply(scene(), 0.004)


def test_a_change_that_moves_the_pins_of_its_own_scene_is_refused(add: Add, repository: Path) -> None:
    moved = '    scene.setup.pins_m["top_left"] = (-0.3, 0.0, 0.0)\n    return scene'
    add("pin_height", re.sub(r"    return .*", moved, example(repository)))
    given = scene()
    pins = dict(given.setup.pins_m)
    with pytest.raises(InputError, match="moves the pins of the very scene") as caught:
        get_effect("pin_height").apply(given, 0.004)
    assert caught.value.code == "effect_file" and given.setup.pins_m == pins


@pytest.mark.parametrize("text", ["edge_curl=magnitude:10,magnitude:20", "bending_hysteresis=magnitude:10,seed:1.5"])
def test_what_would_be_passed_over_is_refused(text: str) -> None:
    with pytest.raises(InputError) as caught:
        effect, size = parse_effect(text)
        effect.apply(scene(), size)
    assert caught.value.code == "effect_magnitude"


def test_two_files_with_one_name_are_refused(add: Add, repository: Path) -> None:
    add("pin_height", example(repository).replace('"pin_height"', '"pin_drop"'))
    with pytest.raises(InputError, match="two files define the effect 'pin_drop'") as caught:
        catalogue()
    assert caught.value.code == "effect_duplicate"


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_place_is_explained(name: str) -> None:
    effect = get_effect(name)
    keys = set(effect.places[0])
    assert all(set(place) == keys for place in effect.places)
    assert all(f"`{key}`" in effect.where or f"`{key} " in effect.where for key in keys)
    assert bool(effect.where) == bool(keys)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_places_are_drawn_as_probable_as_they_are(name: str) -> None:
    effect, rng = get_effect(name), np.random.default_rng(5)
    if effect.vector:
        return
    drawn = [effect.draw(rng, listed=True) for _ in range(2000)]
    at = [effect.places.index({key: size[key] for key in effect.places[0]}) for size in drawn]
    shares = np.bincount(at, minlength=len(effect.places)) / len(at)
    assert effect.place_shares.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(shares, effect.place_shares, atol=0.04)
    for size in (effect.draw(rng) for _ in range(50)):  # where it really is, which may be between those
        assert size == effect.size(size)


def test_creases_are_down_or_across_the_middle_or_anywhere_but_near_the_rim() -> None:
    effect, rng = get_effect("crease"), np.random.default_rng(6)
    assert effect.tried_shares[:2].tolist() == [0.25, 0.25] and effect.tried_shares[2:].min() > 0.02
    positions = np.array([effect.draw(rng)["position"] for _ in range(1000)])
    assert np.mean(positions == 0.5) == pytest.approx(0.5, abs=0.05)
    elsewhere = positions[positions != 0.5]
    tried = np.unique([place["position"] for place in effect.tried])
    assert elsewhere.min() < 0.2 and elsewhere.max() > 0.8
    inside = elsewhere[(elsewhere > 0.2) & (elsewhere < 0.8)]
    assert np.abs(inside[:, None] - tried).min(axis=1).max() <= 0.025


@pytest.mark.parametrize("name", [name for name, effect in sorted(catalogue().items()) if effect.between])
def test_what_goes_in_a_line_with_the_place_is_met_between_those_that_are_simulated(name: str) -> None:
    effect = get_effect(name)
    key = {"crease": "position", "edge_curl": "width_m"}[name]

    def row(size: Mapping[str, float]) -> list[float]:
        way = size.get("down", 1.0)  # lines down and across it do different things
        return [size[SCALAR] * way, size[SCALAR] * way * size[key], size[SCALAR] * (1 - way) * size[key]]

    rows = at_all_places(effect, np.array([row(size) for size in nodes(effect)]))
    for place in effect.tried:
        size = effect.typical() | dict(place)
        np.testing.assert_allclose(node_weights(effect, size) @ rows, row(size), atol=1e-12)
    assert effect.tried_shares.sum() == pytest.approx(1.0)
    assert {effect.number_of(size) for size in nodes(effect)} == set(range(len(effect.places)))
    assert effect.number_of({SCALAR: 1.0}) == 0
    with pytest.raises(InputError, match=f"{name} is not looked for at .*{key} 0.123") as caught:
        effect.number_of({key: 0.123})
    assert caught.value.code == "effect_place"


def test_the_page_is_what_the_command_writes(repository: Path, tmp_path: Path) -> None:
    text = (repository / PAGE).read_text(encoding="utf-8")
    copy = tmp_path / "effects.md"
    copy.write_text(text, encoding="utf-8")
    effect_page.main([str(copy), "--text"])
    assert copy.read_text(encoding="utf-8") == text, "write it again: python -m diagnosis.pages.effect_page --text"


def test_the_page_says_sizes_and_places_as_they_are_drawn_and_written(repository: Path) -> None:
    sections = dict(re.findall(r"^## `(\w+)`(.*?)(?=^## )", (repository / PAGE).read_text(), flags=re.M | re.DOTALL))
    assert set(sections) == set(catalogue())
    for name, effect in catalogue().items():
        assert (repository / "docs" / effect_page.PICTURES / f"{name}.png").exists()
        written = re.findall(rf"`({name}=\S+)`", sections[name])
        assert parse_effect(written[-1])[1] == pytest.approx(effect.typical(), rel=0.01)
        if effect.places[0]:
            last = {SCALAR: effect.typical()[SCALAR], **effect.tried[-1]}
            assert parse_effect(written[0])[1] == pytest.approx(last, rel=0.01)
            for place in effect.tried:
                assert f"`{','.join(f'{k}:{v:g}' for k, v in place.items())}`" in sections[name]
    assert "a vector (rx, ry, rz) of length 0.5 to 2 [deg] in any direction" in sections["camera_rotation"]
    assert "Size: ±0.5 to 1.5 [rad]." in sections["crease"] and "Size: 8 to 50 [g/m]." in sections["hem_weight"]


def test_drawing_says_where_the_colours_end(monkeypatch: pytest.MonkeyPatch, repository: Path, tmp_path: Path) -> None:
    class Artist:
        def draw(self, effect: Effect, path: Path) -> float:
            assert path == tmp_path / effect_page.PICTURES / f"{effect.name}.png"
            return 0.0123

    monkeypatch.setattr(effect_page, "_Artist", Artist)
    effect_page.main([str(tmp_path / "effects.md")])
    drawn = (tmp_path / "effects.md").read_text(encoding="utf-8")
    kept = (repository / PAGE).read_text(encoding="utf-8")
    assert drawn == re.sub(r"colours end at \S+ mm", "colours end at 12 mm", kept)


def test_text_alone_is_refused_where_an_effect_was_not_drawn(add: Add, repository: Path, tmp_path: Path) -> None:
    add("pin_height", example(repository))
    copy = tmp_path / "page" / "effects.md"
    copy.parent.mkdir()
    copy.write_text((repository / PAGE).read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(InputError, match="no picture of pin_height") as caught:
        effect_page.write_page(copy, draw=False)
    assert caught.value.code == "effect_not_drawn"
    assert copy.read_bytes() == (repository / PAGE).read_bytes()
