"""What speaks for an effect, on measurements made up for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.effect import SCALAR
from diagnosis.effects import catalogue, get_effect
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.inference.cause import name_cause
from diagnosis.inference.evidence import _at_places, _of_blocks, tabulate, tabulate_nothing
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.noise import NoiseModel, feature_covariance
from diagnosis.inference.subtract import without
from diagnosis.simulation.sizes import FITTED_SHARE, grid, interpolation, node_weights, nodes
from tests.diagnosis.bare_capture import BARE_CELLS, BARE_LENGTH, bare_capture
from tests.diagnosis.response_rows import random_rows, still_rows

COUNT = 60
FABRICS = 4


def block(fabric: int, scene: str, measured: np.ndarray, responses: dict[str, np.ndarray]) -> Block:
    view = View(measured, responses, {}, 0.001 * np.eye(COUNT), 0.0)
    owner, cell = np.repeat([0, 1], COUNT // 2), np.tile(np.arange(COUNT // 2), 2)
    still = np.zeros((4, COUNT))
    return Block(
        f"f{fabric}", scene, ("a", "b"), view, view, cell, owner, np.zeros((7, COUNT)), still, still, sensed=1.0
    )


def a_set(name: str, size: dict[str, float], shown: range, scene: str = "stretch") -> tuple[list[Block], PixelBlock]:
    """Four fabrics, of which some show an effect; responses of random form, errors of size one."""
    rng = np.random.default_rng(11)
    blocks = []
    for fabric in range(FABRICS):
        responses = {n: random_rows(rng, n, 6.0, COUNT) for n in ("air_draft", "edge_curl")}
        if name not in responses:
            responses[name] = random_rows(rng, name, 6.0, COUNT)
        effect = node_weights(get_effect(name), size) @ responses[name] if fabric in shown else np.zeros(COUNT)
        blocks.append(block(fabric, scene, effect + rng.standard_normal(COUNT), responses))
    still = {n: np.zeros((len(rows), 1)) for n, rows in blocks[0].stated.responses.items()}
    return blocks, PixelBlock(np.zeros(1), still, sensor_known=False)


@pytest.mark.parametrize("taken", [(), ("air_draft",)])
def test_places_are_weighed_one_by_one_as_they_would_be_all_together(taken: tuple[str, ...]) -> None:
    """What an effect does at one place says nothing of another one."""
    curled = {SCALAR: 20.0, **get_effect("edge_curl").tried[2]}
    blocks, _ = a_set("edge_curl", curled, range(FABRICS))
    for name in taken:
        blocks = [without(one, name, {SCALAR: 0.2}) for one in blocks]
    effect, model = get_effect("edge_curl"), LikelihoodModel()
    weights, places = interpolation(effect, grid(effect)), len(effect.tried)
    whole = _of_blocks(blocks, "edge_curl", np.asarray(np.kron(np.eye(places), weights)), model)
    parts = _at_places(blocks, "edge_curl", weights, places, model)
    assert places > 1
    np.testing.assert_allclose(parts.reshape(len(blocks), -1), whole, rtol=1e-12, atol=1e-9)


def test_an_effect_that_all_fabrics_show_is_named_with_its_size() -> None:
    blocks, pixels = a_set("air_draft", {SCALAR: 0.3}, range(FABRICS))
    cause = name_cause(("air_draft", "edge_curl"), blocks, pixels)
    assert cause.named == ("air_draft",)
    assert cause.size("air_draft")[SCALAR] == pytest.approx(0.3, rel=0.1)


@pytest.mark.parametrize("shown", [range(0), range(1)])
def test_what_one_fabric_alone_shows_names_nothing(shown: range) -> None:
    blocks, pixels = a_set("air_draft", {SCALAR: 0.3}, shown)
    assert name_cause(("air_draft", "edge_curl"), blocks, pixels).top == "none"


def test_an_effect_that_these_captures_cannot_show_takes_little_from_none() -> None:
    """Its evidence is that of ``none``, whatever is there: nothing that is seen is its doing."""
    blocks, pixels = a_set("air_draft", {SCALAR: 0.3}, range(0))
    for one in blocks:
        one.stated.responses["panel_friction"] = still_rows("panel_friction", COUNT)
    still = {"panel_friction": still_rows("panel_friction")}
    pixels = replace(pixels, responses=pixels.responses | still)
    cause = name_cause(("air_draft", "edge_curl", "panel_friction"), blocks, pixels)
    assert cause.evidence["panel_friction"].log_evidence == pytest.approx(cause.evidence["none"].log_evidence, abs=1e-6)
    assert cause.top == "none" and 0.0 < cause.probabilities["panel_friction"] < 0.2 * cause.probabilities["none"]


def test_what_fits_one_block_better_does_not_hide_what_explains_them_all() -> None:
    blocks, pixels = a_set("air_draft", {SCALAR: 0.2}, range(FABRICS))
    alone = name_cause(("air_draft",), blocks, pixels)
    odd = [
        replace(b, stated=_with(b.stated, "edge_curl", n), wide=_with(b.wide, "edge_curl", n))
        for n, b in enumerate(blocks)
    ]
    beside = name_cause(("air_draft", "edge_curl"), odd, pixels, pairs=False)
    assert beside.evidence["edge_curl"].by_fabric["f0"] > beside.evidence["air_draft"].by_fabric["f0"]
    gained = [c.evidence["air_draft"].log_evidence - c.evidence["none"].log_evidence for c in (alone, beside)]
    assert gained[1] == pytest.approx(gained[0], rel=0.05)


def _with(view: View, name: str, fabric: int) -> View:
    """A view in which an effect explains everything of the first fabric and nothing of the others."""
    count = len(view.responses[name])
    rows = np.tile(view.measured, (count, 1)) if fabric == 0 else np.zeros((count, COUNT))
    return replace(view, responses=view.responses | {name: rows})


def test_effects_declared_inseparable_are_no_pair() -> None:
    blocks, pixels = a_set("air_draft", {SCALAR: 0.3}, range(FABRICS))
    rng = np.random.default_rng(3)
    grown = []
    for own in blocks:
        tilt = 6.0 * rng.standard_normal((len(nodes(get_effect("panel_tilt"))), COUNT))
        both = own.stated.measured + node_weights(get_effect("panel_tilt"), {SCALAR: 9.0}) @ tilt
        view = replace(own.stated, measured=both, responses=own.stated.responses | {"panel_tilt": tilt})
        grown.append(replace(own, stated=view, wide=view))
    seen = replace(pixels, responses=pixels.responses | {"panel_tilt": np.zeros((len(tilt), 1))})
    assert len(name_cause(("air_draft", "panel_tilt"), grown, seen).named) < 2
    assert name_cause(("air_draft", "panel_tilt"), grown, seen).pair is None


def test_a_vector_answers_backward_otherwise_than_forward() -> None:
    effect, size = get_effect("camera_translation"), {"tx": -0.009, "ty": 0.004, "tz": 0.002}
    assert len(nodes(effect)) == 6
    blocks, pixels = a_set("camera_translation", size, range(FABRICS))
    found = tabulate(effect, blocks, pixels, LikelihoodModel()).sizes[0]
    np.testing.assert_allclose([found[c] for c in size], list(size.values()), atol=0.001)


def test_a_place_that_is_more_probable_has_more_of_the_prior() -> None:
    effect = get_effect("crease")
    blocks, pixels = a_set("crease", {SCALAR: 1.0, "down": 0.0, "position": 0.7}, range(FABRICS))
    table = tabulate(effect, blocks, pixels, LikelihoodModel())
    chance = np.exp(table.prior + table.hold)
    assert float(chance.sum()) == pytest.approx(1.0)
    middle = np.array([size["position"] == 0.5 for size in table.sizes])
    assert float(chance[middle].sum()) == pytest.approx(0.5)
    assert table.chance(table.sizes[3]) == pytest.approx(float(np.log(chance[3])))
    found = name_cause(("air_draft", "crease"), blocks, pixels)
    assert found.named == ("crease",)
    size = found.evidence["crease"].size
    assert (size["down"], size["position"]) == (0.0, 0.7) and size[SCALAR] == pytest.approx(1.0, abs=0.15)
    assert found.evidence["crease"].usual == size  # so that it is simulated there


def test_folds_that_took_up_a_moved_camera_do_not_set_its_size() -> None:
    """Samples in ``hanging`` do not show it at all; their states were sought through the camera as stated."""
    effect, size = get_effect("camera_translation"), {"tx": -0.009, "ty": 0.004, "tz": 0.002}
    shown, pixels = a_set("camera_translation", size, range(FABRICS))
    hidden, _ = a_set("camera_translation", size, range(0), "hanging")
    model, blocks = (
        LikelihoodModel(),
        [*shown, *(replace(b, fabric=a.fabric) for a, b in zip(shown, hidden, strict=True))],
    )
    table = tabulate(effect, blocks, pixels, model)
    np.testing.assert_allclose([table.sizes[0][c] for c in size], list(size.values()), atol=0.001)
    nothing = tabulate_nothing(blocks, pixels, model)
    rough = tabulate(effect, blocks, pixels, replace(model, moved_stretch=0.05))
    for own, first, still in zip(table.blocks[FABRICS:], rough.blocks[FABRICS:], nothing.blocks[FABRICS:], strict=True):
        assert float(own[0] - still[0]) < -10.0  # they speak against it in the end
        assert float(first[0] - still[0]) > np.log(model.moved_hanging) - 0.1  # and not before they were sought with it


def test_in_hanging_a_response_that_is_contradicted_costs_no_more_than_folds_that_moved() -> None:
    blocks, pixels = a_set("air_draft", {SCALAR: 0.3}, range(0), "hanging")
    model = LikelihoodModel()
    nothing = name_cause(("air_draft",), blocks, pixels, model, pairs=False).evidence["none"]
    for value, still in zip(
        tabulate(get_effect("air_draft"), blocks, pixels, model).blocks, nothing.by_fabric.values(), strict=True
    ):
        assert still <= 0.0 and value.min() > value.max() + np.log(model.moved_hanging) - 1.0


def test_effects_that_change_pixels_one_by_one_are_of_the_sensor() -> None:
    white = {name for name, effect in catalogue().items() if effect.white}
    assert white == {"range_noise", "dropout", "quantisation", "edge_flying_pixels"}
    assert not any(get_effect(name).moves_cloth for name in white)


def test_a_capture_whose_folds_were_not_found_is_trusted_less_than_its_repeat() -> None:
    variance = np.diag(feature_covariance([bare_capture(0.001), bare_capture(0.003)], [0.07] * 7, NoiseModel()))
    found, missed = variance[:BARE_CELLS], variance[BARE_LENGTH : BARE_LENGTH + BARE_CELLS]
    np.testing.assert_allclose(missed - found, 0.003**2 - 0.001**2)


def test_what_shows_better_in_another_set_up_is_trusted_as_much() -> None:
    captures = [bare_capture(0.001), bare_capture(0.003, setup=1)]
    variance = np.diag(feature_covariance(captures, [0.07] * 7, NoiseModel()))
    np.testing.assert_allclose(variance[:BARE_CELLS], variance[BARE_LENGTH : BARE_LENGTH + BARE_CELLS])


def test_a_refuted_effect_leaves_its_probability_to_none_and_unknown() -> None:
    blocks, pixels = a_set("air_draft", {SCALAR: 0.3}, range(FABRICS))
    cause = name_cause(("air_draft", "edge_curl"), blocks, pixels)
    left = cause.refuted()
    assert left.probabilities["air_draft"] == pytest.approx(0.1 * cause.probabilities["air_draft"])
    assert sum(left.probabilities.values()) == pytest.approx(1.0)
    assert left.named == () and left.top in ("none", "unknown")


def test_an_effect_that_throws_its_simulations_into_other_folds_is_named_by_weaker_ones() -> None:
    """In three of four fabrics the largest draft was simulated in other folds; the smallest one is right."""
    blocks, pixels = a_set("air_draft", {SCALAR: 0.45}, range(0))
    sizes = np.array([size[SCALAR] for size in nodes(get_effect("air_draft"))])
    rng = np.random.default_rng(3)
    shown = []
    for number, own in enumerate(blocks):
        form = 12.0 * rng.standard_normal(COUNT)
        rows = sizes[:, None] * form
        if number:
            rows[np.abs(sizes) > 0.3] = 6.0 * rng.standard_normal((2, COUNT))
        view = replace(
            own.stated,
            measured=own.stated.measured + 0.45 * form,
            responses={**own.stated.responses, "air_draft": rows},
        )
        shown.append(replace(own, stated=view, wide=view))
    cause = name_cause(("air_draft", "edge_curl"), shown, pixels)
    assert cause.named == ("air_draft",)
    assert cause.size("air_draft")[SCALAR] == pytest.approx(0.45, rel=0.15)


@pytest.mark.parametrize("size", [0.06, 0.3])
def test_the_usual_size_lies_inside_the_range_wherever_the_best_one_does(size: float) -> None:
    blocks, pixels = a_set("air_draft", {SCALAR: size}, range(FABRICS))
    model = LikelihoodModel()
    found = tabulate(get_effect("air_draft"), blocks, pixels, model, as_simulated=True)
    weighed = found.weigh(blocks, [float(value.max()) for value in found.blocks], model)
    component = next(iter(get_effect("air_draft").components.values()))
    faded = np.exp(FITTED_SHARE)  # beyond the range by a standard deviation of fitted sizes: half a nat
    assert component.low / faded <= abs(weighed.usual[SCALAR]) <= component.high * faded
    assert weighed.usual_evidence <= weighed.log_evidence
    assert (weighed.usual == weighed.size) == (size == 0.3)
