"""Something outside the catalogue: what is left over and is common to all fabrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from diagnosis.afresh import refinement
from diagnosis.afresh.fresh import FreshLook
from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.inference.cause import Cause, name_cause
from diagnosis.inference.changes import line_forms, rim_forms
from diagnosis.inference.evidence import Evidence, tabulate_nothing
from diagnosis.inference.likelihood import LikelihoodModel, some_off
from diagnosis.inference.remainder import BY_CHANCE_NATS, NEAR_ENOUGH, Mixture
from diagnosis.inference.said_again import is_said_again
from diagnosis.inference.smooth_modes import smooth_modes
from diagnosis.inference.something_beside import something_beside
from diagnosis.inference.subtract import pixels_without, responses_at_place, without
from diagnosis.inference.unknown import tabulate_unknown, without_repeated
from diagnosis.measurement.features import PLANE_NAMES
from diagnosis.measurement.reference import CELLS, cell_centres
from diagnosis.simulation.sizes import node_weights, nodes

EFFECTS = ("air_draft", "crease")
COUNT = CELLS * CELLS
ERROR_M = 0.0003
FABRICS = 4


def linear_responses(name: str, rng: np.random.Generator) -> np.ndarray:
    """Of random form at each place, as long as the size; three errors long at 0.5."""
    effect = get_effect(name)
    forms = 6.0 * rng.standard_normal((len(effect.places), COUNT))
    sizes = np.array([node[SCALAR] for node in nodes(effect)])
    return sizes[:, None] * np.repeat(forms, len(sizes) // len(forms), axis=0)


def fabrics(
    shown: Sequence[int], change: str | None, pins: Sequence[int] = (4,) * FABRICS, *, probed: bool = False
) -> list[Block]:
    """Fabrics with responses of random form, some of which show a change; errors of 0.3 mm.

    ``change``: an effect's name, "smooth" for a form that no effect has, of 1.2 mm, or a family of changes: "rim" for
    an edge that is lifted by 0.9 mm, "lines" for a fold down the middle as high, "picture" and "pins" for one
    of theirs; "weights" and "bends" for some of the probes, which are known where ``probed``.
    """
    rng = np.random.default_rng(7)
    form = 0.0012 * smooth_modes()[:COUNT] @ rng.standard_normal(smooth_modes().shape[1]) / 3.0
    blocks = []
    for fabric in range(FABRICS):
        rows = {name: linear_responses(name, rng) for name in EFFECTS}
        own = np.random.default_rng(100 + fabric)
        probes = {"weights": 1e-3 * own.standard_normal((4, COUNT)), "bends": 1e-3 * own.standard_normal((2, COUNT))}
        measured = rng.standard_normal(COUNT)
        moved = 0.3 * rng.standard_normal((pins[fabric], COUNT))
        owner, cell = np.zeros(COUNT, dtype=np.intp), np.arange(COUNT)
        parameters = 1e-4 * rng.standard_normal((7, COUNT))
        warps = 1e-4 * rng.standard_normal((8, COUNT))
        of_family = {
            "smooth": form,
            "rim": 0.0009 * rim_forms()[:COUNT, 0],
            "lines": 0.0009 * line_forms()[:COUNT, 2],
            "picture": 3.0 * warps[5],
            "pins": 0.001 * moved[2],
            "weights": 0.5 * probes["weights"][3],
            "bends": 0.3 * (probes["bends"][0] - probes["bends"][1]),
        }
        if fabric in shown and change in of_family:
            measured = measured + of_family[change] / ERROR_M
        elif fabric in shown and change is not None:
            measured = measured + node_weights(get_effect(change), {SCALAR: 0.3}) @ rows[change]
        view = View(measured, rows, {}, ERROR_M * np.eye(COUNT), COUNT * float(np.log(ERROR_M)))
        blocks.append(Block(f"f{fabric}", "stretch", ("a",), view, view, cell, owner, parameters, moved, warps))
        if probed:
            blocks[-1] = replace(blocks[-1], probes=probes)
    return blocks


def quiet(numbers: int = 1) -> PixelBlock:
    rows = {n: np.zeros((len(nodes(get_effect(n))), numbers)) for n in EFFECTS}
    return PixelBlock(np.zeros(numbers), rows, sensor_known=False)


def gains(blocks: list[Block], share: float = 1.0) -> dict[str, float]:
    """By family, of so much of what was measured."""
    mixture = Mixture.of(EFFECTS, blocks, LikelihoodModel())
    return dict(zip(mixture.families, mixture.gain([share * b.stated.measured for b in blocks]), strict=True))


def gain(blocks: list[Block]) -> float:
    return gains(blocks)["all"]


def test_a_form_that_all_fabrics_show_is_predicted_from_the_others() -> None:
    assert gain(fabrics(range(FABRICS), "smooth")) > 5.0


def test_how_another_simulator_differs_within_the_errors_is_nothing_unknown() -> None:
    blocks = fabrics(range(FABRICS), "smooth")
    assert all(float(np.mean((0.15 * block.stated.measured) ** 2)) < NEAR_ENOUGH for block in blocks)
    assert gains(blocks, 0.15)["all"] == 0.0 < 5.0 < gain(blocks)


@pytest.mark.parametrize("shown", [range(0), range(1)])
def test_chance_or_one_fabric_alone_predicts_nothing(shown: Sequence[int]) -> None:
    assert max(gains(fabrics(shown, "smooth")).values()) < 0.0


def test_weights_and_bends_show_where_they_were_put_on_the_cloth_on_trial() -> None:
    for family in ("weights", "bends"):
        found = gains(fabrics(range(FABRICS), family, probed=True))
        assert found[family] > 5.0 > max(value for name, value in found.items() if name != family)
        assert family not in gains(fabrics(range(FABRICS), family))
        assert max(gains(fabrics(range(1), family, probed=True)).values()) < BY_CHANCE_NATS[family]


def test_one_fabric_that_was_not_probed_shows_no_probe() -> None:
    blocks = fabrics(range(FABRICS), "weights", probed=True)
    some = gains([*blocks[:-1], replace(blocks[-1], probes={})])
    assert 2.0 < some["weights"] < gains(blocks)["weights"]


def test_probes_that_do_what_an_effect_of_the_catalogue_does_are_nothing_unknown() -> None:
    blocks = fabrics(range(FABRICS), "weights", probed=True)
    typical = 1.0 / ERROR_M * np.ones((len(nodes(get_effect("hem_weight"))), 1))
    known = []
    for block in blocks:
        rows = block.stated.responses | {"hem_weight": typical * block.probes["weights"][3]}
        view = replace(block.stated, responses=rows)
        known.append(replace(block, stated=view, wide=view))
    found = Mixture.of((*EFFECTS, "hem_weight"), known, LikelihoodModel())
    described = dict(zip(found.families, found.gain([b.stated.measured for b in known]), strict=True))
    assert described["weights"] < 0.0 < gains(blocks)["weights"] - 5.0


def test_pins_are_moved_on_the_cells_they_were_probed_on() -> None:
    """Coarse responses that say otherwise are not heard."""
    blocks = fabrics(range(FABRICS), "pins")
    rng = np.random.default_rng(3)
    spoilt = [replace(b, pins=0.3 * rng.standard_normal(b.pins.shape), probes={"pins": b.pins}) for b in blocks]
    assert gains(spoilt)["pins"] == pytest.approx(gains(blocks)["pins"])


@pytest.mark.parametrize("family", ["rim", "lines", "picture", "pins"])
def test_a_change_shows_most_in_its_own_family_and_in_no_other(family: str) -> None:
    found = gains(fabrics(range(FABRICS), family))
    assert found[family] > found["all"] > 5.0
    others = {name: value for name, value in found.items() if name not in (family, "all")}
    if family == "rim":  # where lines end
        assert others.pop("lines") < 0.5 * BY_CHANCE_NATS["lines"]
    if family == "pins":  # of the same moves
        assert others.pop("one pin") < found["pins"]
    assert max(others.values()) < 0.0


def pins_gain(effects: Sequence[str], move: Sequence[float], family: str = "pins") -> float:
    """What pins alone, or one of them, gain in fabrics put up with all pins moved by two millimetres times ``move``."""
    blocks = []
    for block in fabrics(range(FABRICS), None, pins=(6,) * FABRICS):
        measured = block.stated.measured + 0.002 * np.array(move) @ block.pins / ERROR_M
        rows = {**block.stated.responses, "pin_spacing": linear_responses("pin_spacing", np.random.default_rng(5))}
        view = replace(block.stated, measured=measured, responses=rows)
        blocks.append(replace(block, stated=view, wide=view))
    mixture = Mixture.of(effects, blocks, LikelihoodModel())
    gained = mixture.gain([block.stated.measured for block in blocks])
    return float(dict(zip(mixture.families, gained, strict=True))[family])


def test_pins_moved_as_an_effect_of_the_catalogue_says_are_nothing_unknown() -> None:
    """Nor where the effect's own response is of other folds."""
    outward = [-0.5, 0, 0.5, 0, 0, 0]
    assert pins_gain(EFFECTS, outward) > 8.0
    assert pins_gain((*EFFECTS, "pin_spacing"), outward) < 2.0


def test_a_pin_that_no_effect_moves_so_stays_unknown() -> None:
    downward = [0, -1.0, 0, 0, 0, 0]
    assert pins_gain(EFFECTS, downward) > 8.0
    assert pins_gain((*EFFECTS, "pin_spacing"), downward) > 8.0


def test_one_pin_that_is_moved_shows_by_itself() -> None:
    """Whichever it is; moves of two pins, as an effect makes them, show less as one's."""
    downward, outward = [0, -1.0, 0, 0, 0, 0], [-0.5, 0, 0.5, 0, 0, 0]
    assert pins_gain(EFFECTS, downward, "one pin") > 8.0
    assert pins_gain(EFFECTS, outward, "one pin") < pins_gain(EFFECTS, outward)
    assert pins_gain((*EFFECTS, "pin_spacing"), outward, "one pin") < 2.0


@pytest.mark.parametrize("family", ["rim", "lines", "picture", "pins"])
def test_what_few_changes_find_in_all_fabrics_is_unknown(family: str) -> None:
    assert name_cause(EFFECTS, fabrics(range(FABRICS), family), quiet()).top == "unknown"


def test_another_simulators_smooth_form_is_no_family_of_its_own() -> None:
    assert "forms" not in gains(fabrics(range(FABRICS), None))


def test_the_rim_is_raised_along_each_edge() -> None:
    rims = rim_forms()
    assert rims.shape == (len(cell_centres()), 8) and not rims[COUNT:].any()
    top = rims[:COUNT, 0].reshape(CELLS, CELLS)
    assert top[0].all() and not top[1:].any()
    np.testing.assert_allclose(rims[:COUNT, 1].reshape(CELLS, CELLS)[0], np.linspace(-1, 1, 2 * CELLS + 1)[1::2])


def test_fabrics_whose_pins_differ_in_number_can_still_be_mixed() -> None:
    assert np.isfinite(gain(fabrics(range(FABRICS), "smooth", pins=(4, 4, 8, 4))))


def test_one_fabric_predicts_nothing() -> None:
    assert set(gains(fabrics(range(FABRICS), "smooth")[:1]).values()) == {-np.inf}


def test_what_an_effect_of_another_size_would_change_is_granted() -> None:
    """A size that was fitted too small leaves something in all fabrics, which speaks for nothing unknown."""
    blocks = fabrics(range(FABRICS), "air_draft")
    small = {SCALAR: 0.15}
    left = [without(block, "air_draft", small).stated.measured for block in blocks]
    own = [responses_at_place(block.stated.responses, "air_draft", small) for block in blocks]
    mixture = Mixture.of(EFFECTS, blocks, LikelihoodModel())
    assert mixture.gain(left)[0] > 5.0 and mixture.gain(left, own).max() < 0.0


def test_responses_at_a_place_are_those_of_that_place_alone() -> None:
    effect = get_effect("crease")
    rows = np.arange(float(len(nodes(effect))))[:, None]
    size = {SCALAR: 0.8} | dict(effect.places[1])
    chosen = responses_at_place({"crease": rows}, "crease", size)
    weights = node_weights(effect, size)
    assert set(rows[weights != 0, 0]) <= set(chosen[:, 0]) and len(chosen) * len(effect.places) == len(rows)


def test_what_no_effect_describes_is_unknown() -> None:
    assert name_cause(EFFECTS, fabrics(range(FABRICS), "smooth"), quiet()).top == "unknown"


def test_an_effect_of_the_catalogue_leaves_nothing_over() -> None:
    cause = name_cause(EFFECTS, fabrics(range(FABRICS), "air_draft"), quiet())
    assert cause.named == ("air_draft",) and cause.probabilities["unknown"] < 0.1


@pytest.mark.parametrize(
    ("alone", "left", "gained", "again"),
    [
        (20.0, -3.0, 15.0, True),  # the effect explains it
        (20.0, 5.0, 15.0, True),  # nearly all of it
        (20.0, 10.0, 15.0, False),  # half of it is left over
        (20.0, -3.0, 6.0, False),  # granted any size it would, at its own it gains little
        (-2.0, -3.0, 1.0, False),  # there is nothing to explain
    ],
)
def test_a_mixture_that_says_what_an_effect_says_is_nothing_unknown(
    alone: float, left: float, gained: float, again: bool
) -> None:
    assert is_said_again(alone, left, gained) is again


@pytest.mark.parametrize("alone", [60.0, 20.0])
@pytest.mark.parametrize(("left_by_both", "unknown"), [(-5.0, False), (30.0, True)])
def test_what_two_effects_say_together_is_nothing_unknown(
    alone: float, left_by_both: float, unknown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mixture that gains much, and 40 nats beside either effect, counts only if both together leave it much, too."""
    size = {SCALAR: 1.0, **get_effect("crease").places[0]}
    blocks = []
    for block in fabrics(range(FABRICS), "air_draft"):
        crease = node_weights(get_effect("crease"), size) @ block.stated.responses["crease"]
        view = replace(block.stated, measured=block.stated.measured + crease)
        blocks.append(replace(block, stated=view, wide=view))
    of_one = {len(responses_at_place(blocks[0].stated.responses, name, size)) for name in EFFECTS}

    def gain(self: Mixture, left: object, granted: Sequence[np.ndarray]) -> np.ndarray:
        count = len(granted[0])
        nats = alone if not count else 40.0 if count in of_one else left_by_both
        return np.full(len(self.families), nats)

    monkeypatch.setattr(Mixture, "gain", gain)
    cause = name_cause(EFFECTS, blocks, quiet())
    assert (cause.top == "unknown") is unknown
    assert unknown or set(cause.named) == set(EFFECTS)


def test_shared_numbers_that_contradict_an_effect_speak_for_something_unknown() -> None:
    pixels = quiet(len(PLANE_NAMES))
    off = PixelBlock(np.full(len(PLANE_NAMES), 40.0), pixels.responses, sensor_known=False)
    blocks = fabrics(range(FABRICS), "air_draft")
    assert name_cause(EFFECTS, blocks, pixels).named == ("air_draft",)
    assert name_cause(EFFECTS, blocks, off).top == "unknown"


@pytest.mark.parametrize(("by_first", "by_second", "named"), [(0.0, 0.0, ()), (8.0, 0.0, (1,)), (0.0, 8.0, (1, 2))])
def test_a_number_that_no_named_effect_changes_is_something_unknown(
    by_first: float, by_second: float, named: tuple[int, ...]
) -> None:
    """One number is off by 8 deviations beside an effect that is sure: nothing of that is granted to an effect that
    cannot change it; an effect that does, or a second one that does, explains it."""
    blocks = fabrics(range(FABRICS), "air_draft")
    rows = {n: np.zeros((len(nodes(get_effect(n))), len(PLANE_NAMES))) for n in (*EFFECTS, "dropout")}
    for block in blocks:
        block.stated.responses["dropout"] = np.zeros((len(rows["dropout"]), COUNT))
    rows["air_draft"][:, 2] = by_first
    rows["dropout"][:, 2] = by_second
    off = PixelBlock(np.array([0.0, 0.0, 8.0]), rows, sensor_known=False)
    cause = name_cause((*EFFECTS, "dropout"), blocks, off)
    assert set(cause.named) == {("", "air_draft", "dropout")[n] for n in named}
    assert named or cause.top == "unknown"


def test_numbers_that_an_effect_explains_say_nothing_unknown() -> None:
    """Of what they say for something unknown alone, no more than what the effect gains, and what it leaves, stays."""
    blocks, model = fabrics(range(0), None), LikelihoodModel()
    rows = {n: np.zeros((len(nodes(get_effect(n))), len(PLANE_NAMES))) for n in EFFECTS}
    rows["air_draft"][:, 2] = 80.0
    pixels = PixelBlock(np.array([0.0, 0.0, 80.0]), rows, sensor_known=False)
    evidence = dict(name_cause(EFFECTS, blocks, pixels, model, pairs=False).evidence)
    nothing, numbers = evidence["none"].log_evidence, some_off(pixels, model)
    left = some_off(pixels_without(pixels, "air_draft", evidence["air_draft"].size), model)
    assert numbers > 15.0 and left < 0.0

    def repeated(gained: float) -> float:
        own = replace(evidence["air_draft"], log_evidence=nothing + gained)
        found = evidence | {"air_draft": own}
        shares = dict.fromkeys(found, 0.25)
        return something_beside(EFFECTS, blocks, pixels, model, found, shares, []).repeated

    assert repeated(0.6 * numbers) == pytest.approx(0.4 * numbers - left)
    assert repeated(0.4 * numbers) == 0.0  # it gains too little
    wild, calm = tabulate_unknown(blocks, pixels, model), tabulate_nothing(blocks, pixels, model)
    less = without_repeated(wild, calm, 5.0).pixels - wild.pixels
    assert set(less.tolist()) == {0.0, -5.0} and less[-1] == -5.0


@pytest.mark.parametrize(("left", "named"), [(1.0, ("camera_translation",)), (7.0, ())])
def test_a_camera_leaves_no_warp_that_all_fabrics_share(
    left: float, named: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it does to pictures is known exactly: a focal length that is off looks like a camera moved, but for that."""
    rng, size = np.random.default_rng(3), {"tx": 0.006, "ty": -0.004, "tz": 0.0}
    effect, blocks = get_effect("camera_translation"), []
    for block in fabrics(range(0), None):
        rows = 2.0 * rng.standard_normal((len(nodes(effect)), COUNT))
        measured = block.stated.measured + node_weights(effect, size) @ rows
        view = replace(block.stated, measured=measured, responses=block.stated.responses | {"camera_translation": rows})
        blocks.append(replace(block, stated=view, wide=view))
    still = {**quiet().responses, "camera_translation": np.zeros((len(nodes(effect)), 1))}
    pixels, names = PixelBlock(np.zeros(1), still, sensor_known=False), (*EFFECTS, "camera_translation")
    gained = name_cause(names, blocks, pixels, pairs=False).evidence
    nats = gained["camera_translation"].log_evidence - gained["none"].log_evidence

    moved = len(responses_at_place(blocks[0].stated.responses, "camera_translation", size))

    def gain(self: Mixture, given: object, granted: Sequence[np.ndarray]) -> np.ndarray:
        value = left if len(granted[0]) == moved else 1.9 * nats
        return np.array([value if name == "picture" else 0.0 for name in self.families])

    monkeypatch.setattr(Mixture, "gain", gain)
    assert name_cause(names, blocks, pixels).named == named


def test_a_weaker_effect_beside_a_strong_one_is_looked_at_too(monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[str] = []

    def freshen(look: Any, wanted: Sequence[tuple[str, Any]], scene: str) -> Any:
        looked.extend(name for name, _ in wanted)
        return look.result

    def weigh(results: Sequence[Any], beside: Any) -> Cause:
        strong, weak = (40.0, 1.0) if beside is None else (0.0, 1.0)
        evidence = {
            name: Evidence(name, value, value, {}, size, size, value, {})
            for name, value, size in (
                ("none", 0.0, {}),
                ("sensor_smoothing", strong, {SCALAR: 1.5, "after_noise": 1.0}),
                ("off_grain", weak, {SCALAR: 5.0}),
            )
        }
        top = "sensor_smoothing" if beside is None else "none"
        return Cause({name: float(name == top) for name in evidence}, evidence, strong)

    monkeypatch.setattr(refinement, "freshen", freshen)
    nothing: Any = None
    refinement.look_again({"f1": FreshLook(nothing, nothing)}, weigh, "stretch")
    assert looked == ["off_grain"]


def test_what_is_looked_at_again_is_of_a_size_inside_its_range() -> None:
    """The best size may lie below it, where a response of other folds vanishes and nothing is learnt."""
    evidence = {
        "none": Evidence("none", 0.0, 0.0, {}, {}, {}, 0.0, {}),
        "off_grain": Evidence("off_grain", 1.0, 1.0, {}, {SCALAR: 2.0}, {SCALAR: 5.0}, -1.0, {}),
        "hem_weight": Evidence("hem_weight", 2.0, 2.0, {}, {SCALAR: 4.0}, {SCALAR: 9.0}, -20.0, {}),
    }
    found = refinement.candidates(Cause({"none": 1.0, "off_grain": 0.0, "hem_weight": 0.0}, evidence, 0.0))
    assert found == [("off_grain", {SCALAR: 5.0})]
